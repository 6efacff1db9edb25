"""`python -m benchmarks.protocols.floor_plans PROTOCOL PATH`: floor plans of other projects.

A point without dynamics (`benchmarks.ideal`) explores each plan as its protocol asks, in the closed
loop of this library. Only the data are theirs: a path that the user gives. Range of the lidar,
start and end are those of the protocol. The inverse sensor model is ours, and a cell is seen when
it is known to be free. Cells are 0.1 m, and the point moves at 1 m/s in steps of some cells. Each
step begins with a scan without noise, and counts as a straight line. The point enters every free
cell, and passes no corner between two diagonal walls. Plans are explored with the top row at y = 0,
mirrored, which changes no length.

`ariadne FOLDER`: dungeon maps of marmotlab/ARiADNE, one of the folders `easy`, `medium`, `complex`.
Cells above grey 150 are free, and the start is pixel 127 of those of grey 208, row by row. The
lidar has 720 beams of 80 px. A run is done when at most 250 free cells are unseen. The result is
the travel in px, with mean and standard deviation over the maps.
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
    `clusters/run_explore.job`. Confirmed in a configuration of castacks/pipe-planner, by the same
    group and on the same plans: 20 m, 2500 beams, 10 cells per metre and 1000 steps. Found in
    copies of their code only: halving, the frame, 3 cells per step, and how coverage counts. Not
    confirmed: the starts themselves, and the shapes of the plans. Different here: their 3 cells are
    along rows and columns, ours are 0.3 m in any direction. A lidar sees nothing off the plan.

`explore-bench PATH`: grids of efc-robot/Explore-Bench, a PGM image or a folder of them. Images are
250 x 250 of 0.1 m, with grey 254 free, 205 unknown and 0 occupied. The lidar has 7 m. The results
are the times to 90 % and to 98 % of the free cells that are connected to the start [s].
    Confirmed in their `GridEnv.py` and blueprints: greys, sizes, 90 %, and 98 % as the end of the
    grid simulator; in Gazebo the end is 99 %. The start is (-8, 8) m from the middle as in their
    training, or the free cell nearest to it; their command for other rules draws it at random. Not
    confirmed: 7 m; their grid simulator is called with 3 m and 3.5 m. Different here: they count
    known cells, occupied ones included, and their scan tests each cell. Here 720 beams do, 0.6
    cells apart at 7 m. They scan at each cell of a way, we scan at every second one. Their times
    are those of a robot in Gazebo, ours those of a point at 1 m/s: seconds are metres.

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
from benchmarks.protocols.plan_files import (
    CELL,
    RADIUS,
    Plan,
    pgms,
    plan_folders,
    pngs,
    read_dungeon,
    read_grid,
    read_kth,
)
from benchmarks.tables import table
from jaxplore import Lidar, OccupancyGrid, Perception
from jaxplore._files import replace_files
from jaxplore._text import one_line
from jaxplore._trees import with_field
from jaxplore.belief.zones import is_unknown
from jaxplore.control.base import Controller
from jaxplore.report.exploration.progress import progress
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.simulation.exploration.checks import check_coverage
from jaxplore.simulation.exploration.reachability import reachable_cells
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.run import Run, simulate

SPEED = 1.0
"""Speed of the point [m/s]."""
MOST_CELLS = 20_000
"""Way after which a run ends that is not done [cells], far beyond a sweep of each plan."""

DUNGEON, MOST_UNSEEN = (480, 640), 250
STEPS = 1000
GRID, GRID_END = (250, 250), 0.98

EXPLORERS: dict[str, Callable[[ExplorationScenario], Controller]] = {
    "explorer": ideal.explorer,
    "nearest-cluster": ideal.nearest_cluster,
    "nearest-frontier": ideal.nearest_frontier,
}


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
    target = target_coverage(protocol, plan)
    scenario = ExplorationScenario(
        _world(plan),
        ideal.Point(SPEED, RADIUS),
        lidar,
        _start(plan),
        perception=Perception(lidar, CELL, RADIUS, margin=0.0, node_spacing=CELL),
        control_rate=rate,
        sensing_rate=rate,
        field_rate=rate,
        target_coverage=1.0 if target is None else target,
    )
    # As data: a share that none reaches stands for no end, in the same program.
    share = check_coverage(target)
    return with_field(scenario, "target_coverage", share)


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
