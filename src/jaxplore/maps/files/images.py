"""Read grey images that are not trusted, for maps and elevations."""

import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxplore._files import open_regular
from jaxplore._text import error_reason, printable_path

if TYPE_CHECKING:
    from PIL import ImageFile

PIXEL_LIMIT = 64_000_000
"""Largest image that is read or written [pixels]."""
BYTE_LIMIT = 2**30
"""Largest file of an image that is copied [bytes]: that many pixels as text."""
HEADER_LIMIT = 2**16
"""Longest header of a portable map, with its comments [bytes]."""

ACCEPTED = "PGM (or another portable map), PNG, BMP, JPEG or WebP"
"""Formats that are read, for messages."""
COMPRESSED_LIMIT = 2**28
"""Largest file of a JPEG or WebP image, which is read whole [bytes]."""
SCANS_LIMIT = 100
"""Greatest number of scans of a JPEG image; an ordinary one has 1 to 10."""

_FORMATS = ("PPM", "PNG", "BMP", "JPEG", "WEBP")
_MODES = ("1", "L", "LA", "P", "RGB", "RGBA", "I", "I;16")


class Greys(NamedTuple):
    """Grey levels of an image, top row first.

    The brightness of a pixel is `level / full`. `opaque` is None for an image without alpha.
    """

    level: NDArray[np.integer]
    full: int
    opaque: NDArray[np.bool_] | None

    @property
    def shade(self) -> NDArray[np.float32]:
        """Brightness of each pixel, (H, W) in [0, 1]; 0 is black."""
        # Look up a table of levels: it is computed in float64 without a float64 copy of the image.
        table = (np.arange(self.full + 1) / self.full).astype(np.float32)
        shade: NDArray[np.float32] = table[self.level]
        return shade


def image_size(path: Path) -> tuple[int, int]:
    """Return the rows and columns of an image file, without reading its pixels.

    It raises as `read_greys`.
    """
    return _open_image(path, lambda image: (image.height, image.width))


def read_greys(path: Path, *, alpha_is_shade: bool = False, is_luma: bool = False) -> Greys:
    """Read an image file of 1 to 16 bits: PGM (or another portable map), PNG, BMP, JPEG or WebP.

    The brightness of a pixel is the mean of red, green and blue, divided by the greatest value of
    the format. With `alpha_is_shade` alpha counts as a fourth colour, as in nav2 until 2025. With
    `is_luma` the brightness is the luma of ITU-R BT.709 in 8 bits and alpha is no colour, as in
    nav2 since.
    """
    return _open_image(path, lambda image: _levels(image, alpha_is_shade, is_luma))


def _open_image[T](path: Path, read: Callable[["ImageFile.ImageFile"], T]) -> T:
    """Open an image, check its format and size, and return what a function makes of it."""
    from PIL import Image  # slow to import, and few need it

    where, accepted = f"image {printable_path(path)}", f"an image in {ACCEPTED}"
    too_large = f"{where} is too large; accepted: at most {PIXEL_LIMIT} pixels"
    # Pillow warns of large images, which are refused here anyway, and of oddities that it handles.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            file = open_regular(path)
            if file is None:
                raise ValueError("it is not there or not a file")
            with file:
                _check_header(file)
                large = _is_compressed_too_large(file)
                if large:
                    raise Image.DecompressionBombError
                image = Image.open(file, formats=_FORMATS)
                if image.mode == "P" and image.palette is None:
                    # Pillow takes all its pixels for black.
                    raise ValueError("it has no palette")
                large = image.width * image.height > PIXEL_LIMIT
                if not large and image.mode in _MODES:
                    return read(image)
        except Image.DecompressionBombError:
            raise ValueError(too_large) from None
        except Exception as error:
            # Pillow raises errors of many kinds for damaged files, also failed assertions.
            reason = error_reason(error)
            raise ValueError(f"{where} cannot be read ({reason}); accepted: {accepted}") from None
    if large:
        raise ValueError(too_large)
    raise ValueError(f"{where} has pixels of type {image.mode}; accepted: {accepted}")


def _check_header(file: BinaryIO) -> None:
    """Refuse the long header of a portable map, which Pillow reads byte by byte.

    A million bytes take it a second. They may be one comment.
    """
    head = file.read(HEADER_LIMIT)
    file.seek(0)
    # The kind, the columns and the rows, and but for bitmaps the greatest value.
    count = 3 if head[:2] in (b"P1", b"P4") else 4
    between, word = rb"(?:\s|#[^\r\n]*+[\r\n])++", rb"[^\s#]++"
    header = word + (between + word) * (count - 1) + rb"[\s#]"
    if head[:1] == b"P" and len(head) == HEADER_LIMIT and not re.match(header, head):
        raise ValueError(f"its header has more than {HEADER_LIMIT} bytes")


def _is_compressed_too_large(file: BinaryIO) -> bool:
    """Check what Pillow and its libraries allocate or repeat before they tell the size: a decoder
    of WebP is made with its canvas, up to 268 million pixels, whose size stands in the first chunk;
    each scan of a JPEG runs over the whole image. A `ValueError` tells of too many scans or
    bytes."""
    head = file.read(30)
    file.seek(0)
    is_webp = head[:4] == b"RIFF" and head[8:12] == b"WEBP"
    if not is_webp and head[:2] != b"\xff\xd8":
        return False
    data = file.read(COMPRESSED_LIMIT + 1)
    file.seek(0)
    if len(data) > COMPRESSED_LIMIT:
        raise ValueError(f"it has more than {COMPRESSED_LIMIT} bytes")
    if not is_webp:
        if data.count(b"\xff\xda") > SCANS_LIMIT:
            raise ValueError(f"it has more than {SCANS_LIMIT} scans")
        return False
    kind, number = head[12:16], int.from_bytes(head[21:25], "little")
    if kind == b"VP8X":
        sides = [1 + int.from_bytes(head[at : at + 3], "little") for at in (24, 27)]
    elif kind == b"VP8L":
        sides = [1 + (number & 0x3FFF), 1 + (number >> 14 & 0x3FFF)]
    else:
        sides = [int.from_bytes(head[at : at + 2], "little") & 0x3FFF for at in (26, 28)]
    return sides[0] * sides[1] > PIXEL_LIMIT


LUMA = (0.212656, 0.715158, 0.072186)
"""Weights of red, green and blue in the luma of ITU-R BT.709, as ImageMagick has them."""


def _levels(image: "ImageFile.ImageFile", alpha_is_shade: bool, is_luma: bool) -> Greys:
    maxval = _portable_maxval(image)
    clear = image.info.get("transparency")
    # Pillow cannot convert 16-bit images without losing bits: read them as they are.
    if image.mode in ("I", "I;16"):
        grey = np.asarray(image)
        levels = _unscale(65535, maxval)[grey]
        opaque = None if clear is None else grey != clear
        if is_luma:
            # Half a level is rounded up, as by ImageMagick.
            levels = np.floor(levels * (255 / (maxval or 65535)) + 0.5).astype(np.uint8)
            return Greys(levels, 255, opaque)
        if not alpha_is_shade or opaque is None:
            return Greys(levels, maxval or 65535, opaque)
        # nav2 averages red, green, blue and alpha. In a grey image the three colours are equal.
        return Greys(3 * levels.astype(np.int32) + 65535 * opaque, 4 * 65535, opaque)
    has_alpha = image.has_transparency_data
    # Grey images are weighted by 3, so that their levels are comparable with sums of three colours.
    if image.mode in ("1", "L", "LA"):
        mode, weight = "LA" if has_alpha else "L", 3
    else:
        mode, weight = "RGBA" if has_alpha else "RGB", 1
    channels = np.asarray(image.convert(mode)).reshape(image.height, image.width, -1)
    colour = channels[..., :-1] if has_alpha else channels
    if is_luma:
        opaque = channels[..., -1] == 255 if has_alpha else None
        return Greys(colour[..., 0] if weight == 3 else _luma(colour), 255, opaque)
    level = weight * _unscale(255, maxval)[colour].sum(axis=-1, dtype=np.uint16)
    full = 3 * (maxval or 255)
    if not has_alpha:
        return Greys(level, full, None)
    alpha = channels[..., -1]
    if alpha_is_shade:
        level, full = level + alpha, full + 255
    return Greys(level, full, alpha == 255)


def _luma(colour: NDArray[np.uint8]) -> NDArray[np.uint8]:
    # In 24 bits of fraction: the weights sum to one exactly, so greys stay as they are.
    weights = np.rint(2.0**24 * np.array(LUMA)).astype(np.uint32)
    weights[1] += np.uint32(2**24 - int(weights.sum()))
    total = np.full(colour.shape[:2], 2**23, np.uint32)
    for index, weight in enumerate(weights):
        total += (np.arange(256, dtype=np.uint32) * weight)[colour[..., index]]
    return (total >> np.uint32(24)).astype(np.uint8)


def _portable_maxval(image: "ImageFile.ImageFile") -> int | None:
    """Return the maxval of a portable map, which Pillow stretches to 8 or 16 bits, or None."""
    args = image.tile[0].args if image.tile else None
    if image.format == "PPM" and isinstance(args, tuple) and isinstance(args[1], int):
        return args[1]
    return None


def _unscale(full: int, maxval: int | None) -> NDArray[np.uint16]:
    # Pillow rounds value / maxval to 8 bits, which can move a cell across a threshold. The rounding
    # never merges two values, so this table undoes it.
    return np.rint(np.arange(full + 1) * ((maxval or full) / full)).astype(np.uint16)
