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

_FORMATS = ("PPM", "PNG", "BMP")
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
    """Return the rows and columns of an image file, without reading its pixels; see `read_greys`.

    Raises:
        ValueError: a file that is missing, malformed, of another format or too large; one line
            that names it.
    """
    return _opened(path, lambda image: (image.height, image.width))


def read_greys(path: Path, *, alpha_is_shade: bool = False) -> Greys:
    """Read an image file of 1 to 16 bits: PGM (or another portable map), PNG or BMP.

    The brightness of a pixel is the mean of red, green and blue, divided by the greatest value of
    the format.

    Args:
        path: path of the file.
        alpha_is_shade: whether the alpha channel counts as a fourth colour, as in nav2.

    Raises:
        ValueError: a file that is missing, malformed, of another format or too large; one line
            that names it.
    """
    return _opened(path, lambda image: _levels(image, alpha_is_shade))


def _opened[T](path: Path, read: Callable[["ImageFile.ImageFile"], T]) -> T:
    """Open an image, check its format and size, and return what a function makes of it."""
    from PIL import Image  # slow to import, and few need it

    where, accepted = f"image {printable_path(path)}", "a PGM, PNG or BMP image"
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


def _levels(image: "ImageFile.ImageFile", alpha_is_shade: bool) -> Greys:
    maxval = _portable_maxval(image)
    clear = image.info.get("transparency")
    # Pillow cannot convert 16-bit images without losing bits: read them as they are.
    if image.mode in ("I", "I;16"):
        grey = np.asarray(image)
        levels = _unscaled(65535, maxval)[grey]
        opaque = None if clear is None else grey != clear
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
    level = weight * _unscaled(255, maxval)[colour].sum(axis=-1, dtype=np.uint16)
    full = 3 * (maxval or 255)
    if not has_alpha:
        return Greys(level, full, None)
    alpha = channels[..., -1]
    if alpha_is_shade:
        level, full = level + alpha, full + 255
    return Greys(level, full, alpha == 255)


def _portable_maxval(image: "ImageFile.ImageFile") -> int | None:
    """Return the maxval of a portable map, which Pillow stretches to 8 or 16 bits, or None."""
    args = image.tile[0].args if image.tile else None
    if image.format == "PPM" and isinstance(args, tuple) and isinstance(args[1], int):
        return args[1]
    return None


def _unscaled(full: int, maxval: int | None) -> NDArray[np.uint16]:
    # Pillow rounds value / maxval to 8 bits, which can move a cell across a threshold. The rounding
    # never merges two values, so this table undoes it.
    return np.rint(np.arange(full + 1) * ((maxval or full) / full)).astype(np.uint16)
