"""`python -m benchmarks.protocols.floor_plans PROTOCOL PATH`: floor plans of other projects.

A point without dynamics (`benchmarks.ideal`) explores each plan as its protocol asks, in the closed
loop of this library. Only the data are theirs: a path that the user gives. Range of the lidar,
start and end are those of the protocol. The inverse sensor model is ours, and a cell is seen when
it is known to be free. Cells are 0.1 m, and the point moves at 1 m/s in steps of some cells. Each
step begins with a scan without noise, and counts as a straight line. The point enters every free
cell, and passes no corner between two diagonal walls. Plans are explored with the top row at y = 0,
mirrored, which changes no length.

`ariadne FOLDER`: dungeon maps of marmotlab/ARiADNE, one of the folders `easy`, `medium`, `complex`
of 100 images. Cells above grey 150 are free, and the start is pixel 127 of those of grey 208, row
by row. The lidar has 720 beams of 80 px. A run is done when at most 250 free cells are unseen. The
result is the travel in px, with mean and standard deviation over the maps.
    Confirmed in their `env.py`, `sensor.py` and `test_driver.py`: all of these numbers, images of
    480 x 640, and a standard deviation divided by N. Not confirmed: which of the folders is used
    for which published figure, and that the images are grey. Different here: their beams see up to
    10 px into walls, ours end at them, and only free cells are counted. They scan at the nodes of a
    lattice, 22 x 17 px apart, we scan every 5 px: at every px a run would take five times as long.
    They count all free cells, we count those that are connected to the start, and say how many are
    not (`cells_apart`).

`mapex FOLDER`: KTH floor plans of castacks/MapEx, the folder `kth_test_maps`, with a folder for
each plan that has `occ_map.npy` (0 occupied, 254 free) and `valid_space.npy` (above 0 where
coverage counts), (H, W) each. Both are halved: a block of 2 x 2 cells is occupied or valid if one
of its cells is. The lidar has 2500 beams of 20 m. The result is the coverage, the share of the
valid cells that are known, free or occupied, after 1000 steps of 3 cells with a scan each.
    Starts are those of a file `starts.csv` in the folder, with lines of `plan,row,column` as their
    `--start_pose` has them: halved cells in a frame of 500. A plan without a line starts in the
    middle of its widest valid place.
    Confirmed in the README of MapEx: the folder, `--start_pose`, and that the starts are in
    `clusters/run_explore.job`. Confirmed in the code of castacks/pipe-planner, by the same group
    and on the same plans: halving, the frame, 20 m, 2500 beams, 10 cells per metre and 1000 steps.
    Confirmed in copies of their code only: 3 cells per step, and how coverage counts. Not
    confirmed: the starts themselves, and the shapes of the plans. Different here: their 3 cells are
    along rows and columns, ours are 0.3 m in any direction. A lidar sees nothing off the plan.

`explore-bench PATH`: grids of efc-robot/Explore-Bench, a PGM image or a folder of them. Images are
250 x 250 of 0.1 m, with grey 254 free, 205 unknown and 0 occupied. The lidar has 7 m. The results
are the times to 90 % and to 98 % of the free cells that are connected to the start [s].
    Confirmed in their `GridEnv.py` and blueprints: greys, sizes, 90 %, and 98 % as the end of the
    grid simulator; in Gazebo the end is 99 %. The start is (-8, 8) m from the middle as in their
    training, or the free cell nearest to it; their command for other rules draws it at random. Not
    confirmed: 7 m, which is from the publication; their grid simulator is called with 3 m and 3.5
    m. Different here: they count known cells, occupied ones included, and their scan tests each
    cell. Here 720 beams do, 0.6 cells apart at 7 m. They scan at each cell of a way, we scan at
    every second one. Their times are those of a robot in Gazebo, ours those of a point at 1 m/s:
    seconds are metres.

Sources: Cao et al., "ARiADNE", ICRA 2023, arXiv 2301.11575. Ho, Kim et al., "MapEx", ICRA 2025,
arXiv 2409.15590. Xu et al., "Explore-Bench", ICRA 2022, arXiv 2202.11931.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from rich.console import Console

from benchmarks import ideal
from benchmarks.tables import table
from jaxplore import Lidar, OccupancyGrid, Perception
from jaxplore._files import replace_files
from jaxplore._text import one_line, printable_path
from jaxplore.belief.zones import is_unknown
from jaxplore.control.base import Controller
from jaxplore.maps.files.images import read_greys
from jaxplore.report.exploration.progress import progress
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.simulation.exploration.reachability import open_spot, reachable_cells
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.run import Run, simulate

CELL, SPEED = 0.1, 1.0
"""Side of a cell [m], and speed of the point [m/s]."""
RADIUS = 0.2 * CELL
"""Radius of the point [m]: less than half a cell, so that it fits in every free cell."""
MOST_CELLS = 20_000
"""Way after which a run ends that is not done [cells], far beyond a sweep of each plan."""

DUNGEON, START_GREY, START_INDEX, FREE_GREY, MOST_UNSEEN = (480, 640), 208, 127, 150, 250
FRAME, STEPS = 500, 1000
GRID, GRID_GREYS, GRID_START, GRID_END = (250, 250), (0, 205, 254), (45, 205), 0.98

EXPLORERS: dict[str, Callable[[ExplorationScenario], Controller]] = {
    "explorer": ideal.explorer,
    "nearest-cluster": ideal.nearest_cluster,
    "nearest-frontier": ideal.nearest_frontier,
}


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


class Protocol(NamedTuple):
    """A protocol.

    Args:
        layout: what its path is, for messages.
        find: returns the files or folders of its plans, by name.
        read: reads the plans of one of them; the shape of an image comes second.
        shape: rows and columns of an image; None for any.
        max_range: range of the lidar [m].
        num_beams: number of its beams.
        cells_per_step: way of the point in a step, which begins with a scan [cells].
        num_steps: greatest number of steps.
        target: returns the coverage at which a run is done, of the number of cells connected to the
            start; None if it ends after `num_steps` only.
        measure: returns the results of a run by name; None for one that was not reached.
    """

    layout: str
    find: Callable[[Path, str], list[Path]]
    read: Callable[[Path, tuple[int, int] | None], list[Plan]]
    shape: tuple[int, int] | None
    max_range: float
    num_beams: int
    cells_per_step: int
    num_steps: int
    target: Callable[[int], float | None]
    measure: Callable[[Plan, Run], dict[str, float | None]]


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


def unseen_target(number: int) -> float:
    """Return the coverage at which at most 250 of a number of free cells are unseen.

    Raises:
        ValueError: no more than 250 cells.
    """
    if number <= MOST_UNSEEN:
        raise ValueError(
            f"{number} free cells are connected to the start; accepted: more than {MOST_UNSEEN}"
        )
    # Half a cell less, so that no rounding of the coverage asks for another cell.
    return (number - MOST_UNSEEN - 0.5) / number


def travel(plan: Plan, run: Run) -> dict[str, float | None]:
    """Return the travel until a run is done, or of the whole run if it is not [px]."""
    _, _, path = _until_done(run)
    return {"travel_px": float(path[-1]) / CELL}


def times(plan: Plan, run: Run) -> dict[str, float | None]:
    """Return the times to 90 % and until a run is done [s]; None for one that was not reached."""
    time, is_done, _ = _until_done(run)
    return {
        "t90_s": run.metrics.as_dict()["time_to"]["90"],
        "total_s": float(time[-1]) if is_done else None,
    }


def valid_coverage(plan: Plan, run: Run) -> dict[str, float | None]:
    """Return the share of the valid cells that are known at the end, free or occupied."""
    is_known = ~np.asarray(is_unknown(OccupancyGrid(_recording(run).belief, CELL)))
    return {"coverage": float(is_known[plan.is_valid].mean())}


def _recording(run: Run) -> ExplorationRecording:
    assert isinstance(run.recording, ExplorationRecording)
    return run.recording


def _until_done(run: Run) -> tuple[np.ndarray, bool, np.ndarray]:
    """Return the times [s] until a run is done, whether it is, and the path until then [m].

    The coverage of an instant is that of the scan at its position, and the point moves on once more
    before the run ends.
    """
    recording = _recording(run)
    time, coverage, _, path = progress(recording)
    target = recording.target_coverage
    is_done = coverage >= np.float32(np.inf if target is None else target)
    end = int(is_done.argmax()) + 1 if is_done.any() else len(time)
    return time[:end], bool(is_done.any()), path[:end]


PROTOCOLS = {
    "ariadne": Protocol(
        "a folder with PNG images of ARiADNE's dungeon maps, such as easy, medium or complex",
        pngs,
        read_dungeon,
        DUNGEON,
        max_range=80 * CELL,
        num_beams=720,
        cells_per_step=5,
        num_steps=MOST_CELLS // 5,
        target=unseen_target,
        measure=travel,
    ),
    "mapex": Protocol(
        "a folder with folders of occ_map.npy and valid_space.npy, such as MapEx's kth_test_maps",
        plan_folders,
        read_kth,
        None,
        max_range=20.0,
        num_beams=2500,
        cells_per_step=3,
        num_steps=STEPS,
        target=lambda number: None,
        measure=valid_coverage,
    ),
    "explore-bench": Protocol(
        "a PGM image of Explore-Bench's datasets, or a folder with them",
        pgms,
        read_grid,
        GRID,
        max_range=7.0,
        num_beams=720,
        cells_per_step=2,
        num_steps=MOST_CELLS // 2,
        target=lambda number: GRID_END,
        measure=times,
    ),
}
"""The protocols by name."""


def read_plans(protocol: Protocol, path: Path, limit: int | None = None) -> Iterator[Plan]:
    """Read the plans of a protocol by name, one after the other.

    Args:
        protocol: the protocol.
        path: file or folder of the user.
        limit: number of files or folders that are read; all when absent.

    Raises:
        ValueError: data of another layout, or too few free cells; one line that names the file.
    """
    for each in protocol.find(path, protocol.layout)[:limit]:
        for plan in protocol.read(each, protocol.shape):
            # Asked again for each run, and here so that a bad plan is found before the first run.
            target_coverage(protocol, plan)
            yield plan


def target_coverage(protocol: Protocol, plan: Plan) -> float | None:
    """Return the coverage at which a run is done; None if it ends after its steps only.

    Raises:
        ValueError: too few free cells.
    """
    try:
        number = int(reachable_cells(_world(plan), _start(plan), RADIUS).sum())
        return protocol.target(number)
    except ValueError as error:
        raise ValueError(f"{plan.name}: {error}") from None


def _world(plan: Plan) -> OccupancyGrid:
    return OccupancyGrid((~plan.is_free).astype(np.float32), CELL)


def _start(plan: Plan) -> np.ndarray:
    """Return the pose (x, y, yaw) in the middle of the cell of the start [m, m, rad]."""
    row, column = plan.start
    return np.array([(column + 0.5) * CELL, (row + 0.5) * CELL, 0.0])


def make_scenario(protocol: Protocol, plan: Plan) -> ExplorationScenario:
    """Return the exploration of a plan by a point; plans of one shape share a program.

    Raises:
        ValueError: too few free cells.
    """
    lidar = Lidar(protocol.num_beams, protocol.max_range, range_noise=0.0)
    rate = SPEED / (protocol.cells_per_step * CELL)
    return ExplorationScenario(
        _world(plan),
        ideal.Point(SPEED, RADIUS),
        lidar,
        _start(plan),
        perception=Perception(lidar, CELL, RADIUS, margin=0.0, node_spacing=CELL),
        control_rate=rate,
        sensing_rate=rate,
        field_rate=rate,
        target_coverage=target_coverage(protocol, plan),
    )


def explore(protocol: Protocol, plan: Plan, explorer: str) -> tuple[Run, dict[str, Any]]:
    """Run an explorer on a plan.

    Returns:
        The run, and its row of the results.

    Raises:
        ValueError: too few free cells.
    """
    scenario = make_scenario(protocol, plan)
    run = simulate(
        EXPLORERS[explorer](scenario),
        scenario,
        protocol.num_steps,
        # Nothing is drawn: scans have no noise.
        key=jax.random.key(0),
        num_trajectories=0,
    )
    recording = _recording(run)
    is_done = _until_done(run)[1] or (
        recording.target_coverage is None and recording.num_steps == protocol.num_steps
    )
    return run, {
        "explorer": explorer,
        "map": plan.name,
        **protocol.measure(plan, run),
        "is_done": is_done,
        "cells": int(recording.reachable.sum()),
        "cells_apart": int((plan.is_free & ~recording.reachable).sum()),
        "collisions": run.metrics.as_dict()["collisions"],
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Explore the plans of a protocol."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.protocols.floor_plans",
        description="Explore the floor plans of another project by its protocol.",
    )
    parser.add_argument("protocol", metavar="PROTOCOL", help=", ".join(PROTOCOLS))
    parser.add_argument("path", type=Path, metavar="PATH", help="its data, a file or a folder")
    parser.add_argument(
        "--explorers", default=",".join(EXPLORERS), help=f"some of {', '.join(EXPLORERS)} [all]"
    )
    parser.add_argument("--limit", type=int, help="number of maps, the first by name [all]")
    parser.add_argument("--out", type=Path, help="JSON file with all numbers")
    options = parser.parse_args(arguments)
    console = Console(width=140)
    rows: list[dict[str, Any]] = []
    try:
        protocol = PROTOCOLS.get(options.protocol)
        if protocol is None:
            raise ValueError(f"protocol is {options.protocol!r}; accepted: {', '.join(PROTOCOLS)}")
        explorers = options.explorers.split(",")
        if unknown := [name for name in explorers if name not in EXPLORERS]:
            raise ValueError(f"explorers has {unknown[0]!r}; accepted: {', '.join(EXPLORERS)}")
        if options.limit is not None and options.limit < 1:
            raise ValueError(f"limit is {options.limit}; accepted: at least 1")
        # Before hours of runs, not after them.
        if options.out is not None and not options.out.parent.is_dir():
            raise ValueError(f"out is {options.out}; accepted: a file in a folder that exists")
        # A bad file is found before the first run; a plan takes less memory than its run.
        plans = list(read_plans(protocol, options.path, options.limit))
        for plan, explorer in ((plan, explorer) for plan in plans for explorer in explorers):
            run, row = explore(protocol, plan, explorer)
            # Ctrl-C ends the simulation early; what was done before still counts.
            if run.metrics.is_interrupted:
                break
            rows.append(row)
            results = {name: row[name] for name in row if name not in NO_RESULTS}
            shown = ", ".join(
                f"{name} not reached" if each is None else f"{name} {each:.2f}"
                for name, each in results.items()
            )
            console.print(f"{plan.name}, {explorer}: {shown}", highlight=False)
        if options.out is not None:
            replace_files([(options.out, (json.dumps(rows, indent=2) + "\n").encode())])
    except (ValueError, OSError) as error:
        print(f"{parser.prog}: {one_line(str(error))}", file=sys.stderr)
        sys.exit(2)
    if rows:
        console.print(table(options.protocol, summarise(rows)))


NO_RESULTS = ("explorer", "map", "is_done", "cells", "cells_apart", "collisions")
"""Entries of a row that are not averaged."""


def summarise(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return mean and standard deviation, divided by N, of the results of each explorer.

    A result that was not reached counts in neither; `not done` is the number of such runs.
    """
    summary = []
    for explorer in dict.fromkeys(row["explorer"] for row in rows):
        chosen = [row for row in rows if row["explorer"] == explorer]
        means: dict[str, float | None] = {}
        for name in (name for name in chosen[0] if name not in NO_RESULTS):
            values = np.array([row[name] for row in chosen if row[name] is not None])
            means[f"{name}, mean"] = float(values.mean()) if len(values) else None
            means[f"{name}, deviation"] = float(values.std()) if len(values) else None
        summary.append(
            {
                "explorer": explorer,
                "runs": len(chosen),
                "not done": sum(not row["is_done"] for row in chosen),
                **means,
            }
        )
    return summary


if __name__ == "__main__":
    main()
