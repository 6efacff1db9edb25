"""Floor plans of other projects, read from files of the user's."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxplore import OccupancyGrid
from jaxplore._text import printable_path
from jaxplore.maps.files.images import read_greys
from jaxplore.simulation.exploration.reachability import open_spot

CELL = 0.1
"""Side of a cell [m]."""
RADIUS = 0.2 * CELL
"""Radius of the point [m]: less than half a cell, so that it fits in every free cell."""
START_GREY, START_INDEX, FREE_GREY = 208, 127, 150
"""Of ARiADNE: grey of the pixels of which one is the start, which one, and bound of free cells."""
FRAME = 500
"""Width of the frame around the plans in which MapEx counts starts [cells]."""
GRID_GREYS, GRID_START = (0, 205, 254), (45, 205)
"""Of Explore-Bench: greys of occupied, unknown and free cells, and row and column of the start."""


class Plan(NamedTuple):
    """A floor plan with a start.

    Args:
        name: name of the plan.
        is_free: (H, W) free cells, the top row first.
        start: row and column of the start.
        is_valid: (H, W) cells that the coverage of MapEx counts; None for another protocol.
    """

    name: str
    is_free: np.ndarray
    start: tuple[int, int]
    is_valid: np.ndarray | None = None


def pngs(path: Path, layout: str) -> list[Path]:
    """Return the PNG images of a folder by name."""
    return _found(path, sorted(path.glob("*.png")), layout)


def pgms(path: Path, layout: str) -> list[Path]:
    """Return a file itself, or the PGM images of a folder by name."""
    return [path] if path.is_file() else _found(path, sorted(path.glob("*.pgm")), layout)


def plan_folders(path: Path, layout: str) -> list[Path]:
    """Return the folders in a folder that have a plan, by name."""
    return _found(path, sorted(each.parent for each in path.glob("*/occ_map.npy")), layout)


def _found(path: Path, found: list[Path], layout: str) -> list[Path]:
    if not found:
        lack = "has none" if path.is_dir() else "is not there"
        raise ValueError(f"{printable_path(path)} {lack}; accepted: {layout}")
    return found


def read_dungeon(path: Path, shape: tuple[int, int] | None) -> list[Plan]:
    """Read a dungeon map of ARiADNE.

    Args:
        path: path of the image.
        shape: rows and columns that it must have.

    Raises:
        ValueError: another image.
    """
    grey = _greys(path, shape)
    marked = np.argwhere(grey == START_GREY)
    if len(marked) <= START_INDEX:
        raise ValueError(
            f"{printable_path(path)} has {len(marked)} pixels of grey {START_GREY}, which mark the "
            f"start; accepted: at least {START_INDEX + 1}"
        )
    row, column = marked[START_INDEX].tolist()
    return [Plan(path.stem, grey > FREE_GREY, (row, column))]


def read_grid(path: Path, shape: tuple[int, int] | None) -> list[Plan]:
    """Read a grid of Explore-Bench.

    Args:
        path: path of the image.
        shape: rows and columns that it must have.

    Raises:
        ValueError: another image, or one without a free cell.
    """
    grey = _greys(path, shape)
    if others := sorted(set(np.unique(grey).tolist()) - set(GRID_GREYS)):
        raise ValueError(
            f"{printable_path(path)} has pixels of grey {others[0]}; accepted: 0 occupied, 205 "
            "unknown, 254 free"
        )
    is_free = grey == GRID_GREYS[-1]
    cells = np.argwhere(is_free)
    if not len(cells):
        raise ValueError(f"{printable_path(path)} has no free cell; accepted: some of grey 254")
    row, column = cells[np.argmin(np.hypot(*(cells - GRID_START).T))].tolist()
    return [Plan(path.stem, is_free, (row, column))]


def _greys(path: Path, shape: tuple[int, int] | None) -> np.ndarray:
    """Read an image as greys (H, W) from 0 to 255."""
    read = read_greys(path)
    if shape is not None and read.level.shape != shape:
        rows, columns = read.level.shape
        raise ValueError(
            f"{printable_path(path)} has {rows} x {columns} pixels; accepted: {shape[0]} x "
            f"{shape[1]}, rows x columns"
        )
    return np.rint(255.0 * read.level / read.full).astype(int)


def read_kth(path: Path, shape: tuple[int, int] | None) -> list[Plan]:
    """Read a KTH floor plan of MapEx, once for each of its starts.

    Args:
        path: folder of the plan, in a folder that may have `starts.csv`.
        shape: rows and columns that the arrays must have; None for any.

    Raises:
        ValueError: other arrays, or a start that is no free cell.
    """
    occupancy, valid = (_array(path / f"{name}.npy") for name in ("occ_map", "valid_space"))
    if occupancy.shape != (shape or valid.shape) or occupancy.shape != valid.shape:
        raise ValueError(
            f"{printable_path(path)} has arrays of {occupancy.shape} and {valid.shape}; accepted: "
            f"{shape or 'one shape'} for both"
        )
    if not np.isin(occupancy, (0, 254)).all():
        raise ValueError(f"{printable_path(path / 'occ_map.npy')}: accepted: 0 and 254 only")
    is_free, is_valid = ~_halved(occupancy == 0, True), _halved(valid > 0, False)
    if not (is_free & is_valid).any():
        raise ValueError(f"{printable_path(path)} has no free cell that is valid; accepted: some")
    starts = _starts(path.parent / "starts.csv").get(path.name)
    if starts is None:
        inside = OccupancyGrid((~(is_free & is_valid)).astype(np.float32), CELL)
        x, y = open_spot(inside, RADIUS)
        return [Plan(path.name, is_free, (int(y / CELL), int(x / CELL)), is_valid)]
    plans = []
    for row, column in starts:
        here = (row - FRAME, column - FRAME)
        is_inside = all(0 <= at < side for at, side in zip(here, is_free.shape, strict=True))
        if not (is_inside and is_free[here]):
            raise ValueError(
                f"{printable_path(path.parent / 'starts.csv')}: {path.name},{row},{column} is no "
                f"free cell; accepted: one, counted from a frame of {FRAME} cells"
            )
        plans.append(Plan(f"{path.name},{row},{column}", is_free, here, is_valid))
    return plans


def _array(path: Path) -> np.ndarray:
    """Read an array (H, W)."""
    try:
        values: np.ndarray = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise ValueError(
            f"{printable_path(path)} cannot be read ({error}); accepted: an array in a .npy file"
        ) from None
    if not isinstance(values, np.ndarray) or values.ndim != 2 or values.dtype.kind not in "biuf":
        raise ValueError(f"{printable_path(path)}: accepted: an array (H, W) of numbers")
    return values


def _halved(mask: np.ndarray, outside: bool) -> np.ndarray:
    """Return whether any cell of each block of 2 x 2 is set; `outside` fills the last blocks."""
    rows, columns = mask.shape
    even = np.pad(mask, ((0, rows % 2), (0, columns % 2)), constant_values=outside)
    blocks: np.ndarray = even.reshape(len(even) // 2, 2, -1, 2).any(axis=(1, 3))
    return blocks


def _starts(path: Path) -> dict[str, list[tuple[int, int]]]:
    """Read the starts of plans from a file of lines `plan,row,column`; none without a file."""
    starts: dict[str, list[tuple[int, int]]] = {}
    for number, line in enumerate(path.read_text().splitlines() if path.exists() else (), 1):
        name, *cell = (word.strip() for word in line.split(","))
        if len(cell) != 2 or not all(word.isdecimal() for word in cell):
            raise ValueError(
                f"{printable_path(path)}: line {number} is {line!r}; accepted: plan,row,column"
            )
        starts.setdefault(name, []).append((int(cell[0]), int(cell[1])))
    return starts
