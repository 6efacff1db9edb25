"""Read and write maps in the format of ROS's `map_server`: a YAML file beside an image."""

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from jaxplore import _checks, _kinds
from jaxplore._files import read_yaml, replace_files
from jaxplore._text import printable_path, short_repr
from jaxplore.maps.datum import Datum
from jaxplore.maps.files.images import PIXEL_LIMIT, Greys, image_size, read_greys

if TYPE_CHECKING:
    from PIL import Image

MODES = ("trinary", "scale", "raw")
"""Conversions from grey to probability; see `read_map`."""
type MapRules = Literal["nav2", "nav2_2025"]
RULES = ("nav2", "nav2_2025")
"""Rules by which an image is read; see `read_map`."""
UNKNOWN_GREY = 205
"""Grey that map savers write for unknown cells."""
NOTABLE_SHARE = 0.01
"""Share of the cells beyond which a doubtful reading is told."""

_UNKNOWN = 0.5
_SUFFIXES = (".yaml", ".yml")


class _Settings(NamedTuple):
    image: Path
    resolution: float
    origin: tuple[float, float, float]
    negate: bool
    occupied_thresh: float
    free_thresh: float
    mode: str


def read_map(
    path: str | os.PathLike[str], *, rules: MapRules = "nav2", unknown: int | None = None
) -> tuple[NDArray[np.float32], float, tuple[float, float, float]]:
    """Read a map: the YAML file at `path` and the image that it names.

    The shade of a pixel is the mean of red, green and blue in [0, 1]. With `occ = 1 - shade`, or
    `occ = shade` if `negate` is set, the probability of a cell depends on `mode`:

    - `trinary`: 1 if `occ > occupied_thresh`, 0 if `occ < free_thresh`, else 0.5. The alpha channel
      counts as a fourth channel of the shade.
    - `scale`: 0.5 if the pixel is not opaque; else 1 and 0 as above, and in between
      `(occ - free_thresh) / (occupied_thresh - free_thresh)`, rounded to hundredths.
    - `raw`: `v / 100` if `v = round(255 shade) <= 100`, else 0.5; `negate` has no effect.

    These are the rules `nav2`, of nav2 until 2025 and of ROS 1. By the rules `nav2_2025`, those of
    nav2 since that year, the shade is the luma of ITU-R BT.709 in 8 bits, both thresholds are
    inclusive (`>=` and `<=`, in single precision), and in `trinary` and `scale` a pixel that is not
    opaque is unknown. A pixel of the grey `unknown` (0 to 255) is unknown whatever the thresholds
    say, such as 205 beside a `free_thresh` of 0.25.

    `image`, `resolution` and `origin` are required. The defaults are `negate` 0, `occupied_thresh`
    0.65, `free_thresh` 0.25 and `mode` trinary. The image is PGM (or another portable map), PNG,
    BMP, JPEG or WebP of at most 64 million pixels. A relative name must stay in the folder of the
    YAML file.

    A `UserWarning` tells if a hundredth of the cells or more are read doubtfully: within a grey
    level of a threshold; as free or occupied although they have the grey 205, which map savers
    write for unknown, or are not opaque.

    Returns:
        Probability (H, W) in [0, 1] with row 0 at the origin (the image's bottom row), resolution
        [m], and pose (x, y, yaw) of the origin [m, m, rad].

    Raises:
        ValueError: a file that is missing, unreadable or malformed, or an entry that is not
            accepted; one line that names it.

    Source: nav2 (ROS 2), `nav2_map_server/src/map_io.cpp`, `loadMapYaml` and `loadMapFromFile`.
    """
    if rules not in RULES:
        raise ValueError(f"rules is {short_repr(rules)}; accepted: {', '.join(RULES)}")
    if unknown is not None:
        unknown = _checks.whole_number("unknown", unknown, at_least=0, at_most=255)
    settings, is_new = _settings(Path(path)), rules == "nav2_2025"
    greys = read_greys(
        settings.image,
        alpha_is_shade=settings.mode == "trinary" and not is_new,
        is_luma=is_new,
    )
    # Convert a table of grey levels: it is exact in float64 without a float64 copy of the map.
    shade = np.arange(greys.full + 1) / greys.full
    table = _probability(shade, settings, is_new).astype(np.float32)
    probability = table[greys.level]
    is_transparency_unknown = settings.mode == "scale" or (is_new and settings.mode == "trinary")
    if greys.opaque is not None and is_transparency_unknown:
        probability[~greys.opaque] = _UNKNOWN
    # Where alpha is a colour, the greys are those without it.
    coloured = greys if greys.opaque is None else read_greys(settings.image, is_luma=is_new)
    if unknown is not None:
        probability[_has_grey(coloured, unknown)] = _UNKNOWN
    doubts = [_savers_doubt(coloured, probability)]
    if settings.mode == "trinary":
        if greys.opaque is not None:
            doubts.append(_alpha_doubt(greys.opaque, probability))
        doubts.append(_thresholds_doubt(greys, table, settings, unknown))
    found = "; ".join(each for each in doubts if each)
    if found:
        _checks.warn_user(f"{printable_path(Path(path))}: {found}")
    # Row 0 of a map is at its origin, the bottom row of the image.
    return np.ascontiguousarray(probability[::-1]), settings.resolution, settings.origin


def map_size(path: str | os.PathLike[str]) -> tuple[int, int, float]:
    """Return the rows, the columns and the resolution [m] of a map, without reading its cells.

    It raises as `read_map`, but does not find what is wrong with the pixels.
    """
    settings = _settings(Path(path))
    return *image_size(settings.image), settings.resolution


@_kinds.check_arguments
def map_datum(path: str | os.PathLike[str]) -> Datum:
    """Return the datum for a map: (0, 0), or its origin in whole metres if that is far away.

    Args:
        path: path of the YAML file; the image is not read.

    Raises:
        ValueError: as of `read_map`, and an origin beyond 1e9 m.
    """
    x, y, _ = _settings(Path(path)).origin
    return Datum.near(x, y, name=f"{printable_path(Path(path))}: origin")


def write_map(
    path: str | os.PathLike[str],
    probability: NDArray[np.floating],
    resolution: float,
    origin: Sequence[float],
    *,
    mode: str = "trinary",
) -> None:
    """Write a map: the YAML file at `path`, and its image beside it under the same stem.

    - `trinary` (PGM): `p > 0.65` becomes 0 (black), `p < 0.25` becomes 254 and the rest 205, the
      greys of ROS's `map_saver`; `read_map` returns 1, 0 and 0.5.
    - `scale` (PNG with alpha): `p` in hundredths; exactly 0.5 (unknown) becomes transparent.
    - `raw` (PGM): `100 p` as the pixel value; exactly 0.5 (unknown) becomes 255.

    From `scale` and `raw`, `read_map` returns `p` rounded to hundredths. Both files are written
    under temporary names and then renamed, the image first. If they cannot be written, nothing is
    left behind and earlier files stay untouched.

    `path` must end in .yaml or .yml. The probability (H, W) in [0, 1] has row 0 at the origin. The
    origin is the pose (x, y, yaw) of the outer corner of cell (0, 0) [m, m, rad].

    Source: nav2 (ROS 2), `nav2_map_server/src/map_io.cpp`, `tryWriteMapToFile`. The thresholds of
    `scale` are 0 and 1, so that no probability is clipped.
    """
    replace_files(map_files(path, probability, resolution, origin, mode=mode))


def map_files(
    path: str | os.PathLike[str],
    probability: NDArray[np.floating],
    resolution: float,
    origin: Sequence[float],
    *,
    mode: str = "trinary",
) -> list[tuple[Path, bytes]]:
    """Return the paths and the contents of the files of a map, the image first; see `write_map`."""
    path = Path(path)
    if path.suffix.lower() not in _SUFFIXES:
        raise ValueError(
            f"path is {printable_path(path)}; accepted: a name that ends in .yaml or .yml"
        )
    if mode not in MODES:
        raise ValueError(f"mode is {short_repr(mode)}; accepted: {', '.join(MODES)}")
    values = np.asarray(probability)
    if values.ndim != 2 or not 0 < values.size <= PIXEL_LIMIT:
        raise ValueError(
            f"probability has shape {values.shape}; accepted: (H, W) of 1 to {PIXEL_LIMIT} cells"
        )
    if not ((values >= 0) & (values <= 1)).all():
        raise ValueError(
            f"probability spans {values.min()} to {values.max()}; accepted: values in [0, 1]"
        )
    image_path = path.with_suffix(".png" if mode == "scale" else ".pgm")
    # Unknown is 205, and 1 - 205/255 = 0.19608 is below 0.25: with the default free_thresh every
    # unknown cell would be read as free. 0.196 is what map_saver has always written.
    free, occupied = {"trinary": (0.196, 0.65)}.get(mode, (0.0, 1.0))
    text = yaml.safe_dump(
        {
            "image": image_path.name,
            "mode": mode,
            "resolution": _number("resolution", resolution, above=0.0),
            "origin": list(_origin("origin", origin)),
            "negate": 0,
            "occupied_thresh": occupied,
            "free_thresh": free,
        },
        sort_keys=False,
        default_flow_style=None,
        allow_unicode=True,
        width=2**31,
    )
    image = io.BytesIO()
    _grey_image(values[::-1], mode).save(image, format="PNG" if mode == "scale" else "PPM")
    # The image is first, so that the YAML file never names one that is not there.
    return [(image_path, image.getvalue()), (path, text.encode())]


def _settings(path: Path) -> _Settings:
    entries = read_yaml(path)
    where = printable_path(path)
    for key in ("image", "resolution", "origin"):
        if key not in entries:
            raise ValueError(f"{where}: {key} is missing; accepted: image, resolution and origin")
    threshold = {"at_least": 0.0, "at_most": 1.0}
    free = _number(f"{where}: free_thresh", entries.get("free_thresh", 0.25), **threshold)
    occupied = _number(
        f"{where}: occupied_thresh", entries.get("occupied_thresh", 0.65), **threshold
    )
    if free >= occupied:
        raise ValueError(
            f"{where}: free_thresh is {free}; accepted: less than occupied_thresh, {occupied}"
        )
    mode = entries.get("mode", "trinary")
    mode = mode.lower() if isinstance(mode, str) else mode
    if not isinstance(mode, str) or mode not in MODES:
        raise ValueError(f"{where}: mode is {short_repr(mode)}; accepted: {', '.join(MODES)}")
    negate = entries.get("negate", 0)
    # yaml-cpp, which nav2 reads by, does not tell quoted numbers from others.
    if isinstance(negate, str):
        negate = {"0": 0, "1": 1, "false": 0, "true": 1}.get(negate.lower(), negate)
    if not isinstance(negate, int) or negate not in (0, 1):
        raise ValueError(f"{where}: negate is {short_repr(negate)}; accepted: 0, 1, true, false")
    return _Settings(
        image=_image_path(path, entries["image"]),
        resolution=_number(f"{where}: resolution", entries["resolution"], above=0.0),
        origin=_origin(f"{where}: origin", entries["origin"]),
        negate=bool(negate),
        occupied_thresh=occupied,
        free_thresh=free,
        mode=mode,
    )


def _image_path(path: Path, entry: object) -> Path:
    where, accepted = printable_path(path), "the name of an image file"
    if not isinstance(entry, str) or not entry or "\0" in entry:
        raise ValueError(f"{where}: image is {short_repr(entry)}; accepted: {accepted}")
    try:
        # A map from an untrusted source must not read files elsewhere by a relative name.
        folder = path.parent.resolve()
        image = (folder / entry).resolve()
        if not Path(entry).is_absolute() and not image.is_relative_to(folder):
            raise ValueError(
                f"{where}: image is {short_repr(entry)}, outside the map's folder; "
                "accepted: a name within it, or an absolute path"
            )
        found = image.is_file()
    except (OSError, RuntimeError):  # a name that is too long, or a loop of symbolic links
        found = False
    if not found:
        raise ValueError(
            f"{where}: image is {short_repr(entry)}, which is not there or not a file; "
            f"accepted: {accepted}"
        )
    return image


def _probability(
    shade: NDArray[np.float64], settings: _Settings, is_new: bool
) -> NDArray[np.floating]:
    if settings.mode == "raw":
        value = np.floor(255 * shade + 0.5)  # rounds half up like C's round; rint rounds to even
        return np.where(value <= 100, value / 100, _UNKNOWN)
    low, high = settings.free_thresh, settings.occupied_thresh
    between: NDArray[np.floating] | float = _UNKNOWN
    if is_new:
        shade32 = shade.astype(np.float32)
        new_occ = shade32 if settings.negate else np.float32(1.0) - shade32
        low32, high32 = np.float32(low), np.float32(high)
        if settings.mode == "scale":
            percent = (new_occ - low32) / (high32 - low32) * np.float32(100.0)
            between = np.floor(percent + np.float32(0.5)) / np.float32(100.0)
        return np.where(new_occ <= low32, 0.0, np.where(new_occ >= high32, 1.0, between))
    occ = shade if settings.negate else 1.0 - shade
    if settings.mode == "scale":
        between = np.rint((occ - low) / (high - low) * 100.0) / 100.0
    return np.where(occ > high, 1.0, np.where(occ < low, 0.0, between))


def _has_grey(greys: Greys, grey: int) -> NDArray[np.bool_]:
    """Return the pixels of a grey from 0 to 255, rounded."""
    table = np.floor(np.arange(greys.full + 1) * (255 / greys.full) + 0.5) == grey
    found: NDArray[np.bool_] = table[greys.level]
    return found


def _savers_doubt(greys: Greys, probability: NDArray[np.float32]) -> str:
    """Return in words that a map saver's grey of unknown cells is read as something else."""
    for value, word in ((0.0, "free"), (1.0, "occupied")):
        share = float(np.mean(_has_grey(greys, UNKNOWN_GREY) & (probability == value)))
        if share >= NOTABLE_SHARE:
            return (
                f"{100 * share:.1f} % of the cells have grey {UNKNOWN_GREY}, which map savers "
                f"write for unknown, and are read as {word}; unknown={UNKNOWN_GREY}, in settings "
                "map_file.unknown, reads them as unknown"
            )
    return ""


def _alpha_doubt(opaque: NDArray[np.bool_], probability: NDArray[np.float32]) -> str:
    """Return in words that what is not opaque is read as free or occupied."""
    share = float(np.mean(~opaque & (probability != _UNKNOWN)))
    if share < NOTABLE_SHARE:
        return ""
    return (
        f"{100 * share:.1f} % of the cells are not opaque and are read as free or occupied; "
        "rules=nav2_2025, in settings map_file.rules, reads them as unknown"
    )


def _thresholds_doubt(
    greys: Greys, table: NDArray[np.float32], settings: _Settings, unknown: int | None
) -> str:
    """Return in words which cells of a trinary map lie within a grey level of a threshold.

    Left out are those of a grey that is read as it is meant: `unknown`, or that of map savers.
    """
    counts = np.bincount(greys.level.ravel(), minlength=greys.full + 1) / greys.level.size
    grey = np.arange(greys.full + 1) * (255 / greys.full)
    occ = grey if settings.negate else 255 - grey
    meant = UNKNOWN_GREY if unknown is None else unknown
    is_doubtful = (np.abs(grey - meant) >= 0.5) | ((table != _UNKNOWN) & (unknown is None))
    said = []
    for name, value, word in (("free_thresh", 0.0, "free"), ("occupied_thresh", 1.0, "occupied")):
        threshold = getattr(settings, name)
        near = np.where((np.abs(occ - 255 * threshold) <= 1.0) & is_doubtful, counts, 0.0)
        if near.sum() < NOTABLE_SHARE:
            continue
        shares = (
            (near[table == value].sum(), word, "unknown"),
            (near[table == _UNKNOWN].sum(), "unknown", word),
        )
        changes = " and ".join(
            f"{100 * share:.1f} % read as {one} would be {other}"
            for share, one, other in shares
            if share
        )
        said.append(
            f"{changes} one grey level further: they lie at {name} {threshold:g}, most of them of "
            f"grey {np.rint(grey[np.argmax(near)]):g}"
        )
    return "; ".join(said)


def _grey_image(values: NDArray[np.floating], mode: str) -> "Image.Image":
    from PIL import Image  # slow to import, and few need it

    if mode == "trinary":
        grey = np.where(values > 0.65, 0, np.where(values < 0.25, 254, 205))
        return Image.fromarray(grey.astype(np.uint8))
    known = values != _UNKNOWN
    percent = np.rint(100.0 * values)
    if mode == "raw":
        return Image.fromarray(np.where(known, percent, 255).astype(np.uint8))
    grey = np.rint(255.0 * (1.0 - percent / 100.0))
    return Image.fromarray(np.stack([grey, np.where(known, 255, 0)], axis=-1).astype(np.uint8))


def _number(name: str, value: object, **bounds: float) -> float:
    # PyYAML leaves numbers such as 5e-2 as text, which yaml-cpp reads as a number: accept text.
    try:
        if isinstance(value, bool) or not isinstance(value, (int, float, str)):
            raise ValueError
        value = float(value)
    except (ValueError, OverflowError):
        raise ValueError(f"{name} is {short_repr(value)}; accepted: a finite number") from None
    return _checks.number(name, value, **bounds)


def _origin(name: str, value: object) -> tuple[float, float, float]:
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        raise ValueError(f"{name} is {short_repr(value)}; accepted: 3 finite numbers [x, y, yaw]")
    x, y, yaw = (_number(f"{name}[{i}]", entry) for i, entry in enumerate(value))
    return x, y, yaw
