"""`python -m benchmarks.protocols.distance_advantage CLONE`: the simulator of lericson/da.

A point robot explores an office of 0.25 m cells with a lidar of 360 beams and 4.5 m, from ten
starts, until no frontier is left. The simulator, its map, starts, scans and judge are those of the
clone. Only the rule that chooses where to go is ours: the robot descends the cost-to-go to the
remaining information (`jaxplore.belief.exploration_field`), and after each scan that changes the
map it plans again. Where little information is left but frontiers are, it goes to the nearest one,
as the protocol asks for all of them.

Source: Ericson, Pedro and Jensfelt, "Information gain is not all you need", arXiv 2504.01980.
Published there, in metres: 1435.9 +- 30.2 with perfect predictions of the map, 1602.9 +- 26.0
without, nearest frontier 1905.4 +- 54.4, information gain 2014.2 +- 43.4.

The clone needs numba and tqdm, `pip install numba tqdm`.
"""

import argparse
import dataclasses
import importlib
import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from rich.console import Console

from benchmarks.history import results_file
from benchmarks.tables import table
from jaxplore import Lidar, OccupancyGrid, Perception
from jaxplore._files import replace_files
from jaxplore.belief.belief import Belief
from jaxplore.belief.descent import NEIGHBOURS
from jaxplore.belief.exploration_field import LEFTOVER_DETOUR
from jaxplore.maps.clearance import clearance_field, find_closed_cells

FILES = ("da/main.py", "da/gridmaps.py", "da/lidar.py", "da/utils.py", "da/office_walls.csv")
"""Files of a clone that are read."""
SEGMENTS, WALL_METRES = 2036, 3155.8
"""Number of walls of the office, and their whole length."""
NUM_STARTS, SEED, CELLS_PER_METRE = 10, 42, 4
RANGE, BEAMS = 4.5, 360
SPEED, PERIOD = 1.0, 0.2
"""Speed of the point robot, and time for a plan, by which time near a place is counted [m/s, s]."""
SEEN = RANGE - 2.0 / CELLS_PER_METRE
"""Distance within which a scan makes cells known for our rule [m]. The simulator calls a cell free
if none of its neighbours is unknown, so the outermost cells of a scan stay unknown."""
PARAMETERS = {"decay_length": 1.0, "min_information": 0.3}
"""Parameters of our rule, see `Perception`. The protocol ends with the last frontier, and what is
left behind costs a second tour: so distance counts more than information, and small places do not
wait."""
MEMORY = 1e6
"""Time constant with which time near a place is forgotten [s]."""
RULES = ("explorer", "nearest-frontier", "distance-advantage", "information-gain")


def load(clone: Path) -> Any:
    """Import the simulator of a clone and set its options to those of the protocol.

    Raises:
        ValueError: a folder without its files, another map, a package that is missing.
    """
    for name in FILES:
        if not (clone / name).is_file():
            raise ValueError(f"{clone} has no {name}; accepted: a clone of lericson/da")
    walls = np.loadtxt(clone / FILES[-1], delimiter=",", ndmin=2)
    if walls.shape != (SEGMENTS, 4):
        raise ValueError(
            f"{clone / FILES[-1]} has {walls.shape[0]} walls of {walls.shape[1]} numbers; "
            f"accepted: {SEGMENTS} of 4"
        )
    length = float(np.hypot(*(walls[:, 2:] - walls[:, :2]).T).sum())
    if abs(length - WALL_METRES) > 1.0:
        raise ValueError(
            f"the walls of {clone / FILES[-1]} are {length:.1f} m long; accepted: {WALL_METRES} m, "
            "those of the published map"
        )
    sys.path.insert(0, str(clone))
    try:
        simulator = importlib.import_module("da.main")
    except ModuleNotFoundError as error:
        raise ValueError(
            f"the package {error.name} is not installed; accepted: pip install {error.name}"
        ) from None
    finally:
        sys.path.remove(str(clone))
    options = {
        "predictions": False,
        "cells_per_meter": CELLS_PER_METRE,
        "lidar_r_max": RANGE,
        "lidar_num_points": BEAMS,
        "seed": SEED,
    }
    simulator.parse_args([f"--{name}={value}" for name, value in options.items()])
    return simulator


class Guide:
    """The rule of `explorer` on the maps of the simulator, whose first axis is x.

    Args:
        scale: side of a cell [m].
        **numbers: parameters of `Perception`.
    """

    def __init__(self, scale: float, **numbers: Any) -> None:
        self.scale = scale
        # A point robot fits in every free cell: its clearance is less than half a cell.
        self._perception = Perception(
            Lidar(BEAMS, SEEN, range_noise=0.0),
            scale,
            0.2 * scale,
            margin=0.0,
            node_spacing=scale,
            # What could not be seen once from a place cannot be seen later either.
            memory=MEMORY,
            **numbers,
        )
        self._belief: Belief | None = None
        self._driven = 0.0

    def path(
        self, probability: np.ndarray, cell: tuple[int, int], driven: float
    ) -> list[tuple[int, int]]:
        """Return the cells of the way down the cost-to-go; one cell where little is left.

        Args:
            probability: (X, Y) probabilities of occupancy.
            cell: cell of the robot.
            driven: length of its path so far [m].
        """
        column, row = cell
        pose = jnp.asarray([(column + 0.5) * self.scale, (row + 0.5) * self.scale, 0.0])
        grid = OccupancyGrid(jnp.asarray(probability.T), self.scale).settle()
        # A robot that stands still must give up what it cannot see as well.
        elapsed = jnp.asarray((driven - self._driven) / SPEED + PERIOD, jnp.float32)
        if self._belief is None:
            self._belief = self._perception.init(grid, pose)
        self._belief = _known(self._perception, self._belief, grid, pose, elapsed)
        self._driven = driven
        values = np.asarray(self._belief.guidance.values, np.float64)
        # What counts as left over is taken in the order of the protocol's frontiers.
        if values[row, column] > 0.5 * LEFTOVER_DETOUR:
            return [cell]
        is_free = np.asarray(grid.is_free)
        return [(int(c), int(r)) for r, c in _descent(values, is_free, (row, column))]


@eqx.filter_jit
def _known(
    perception: Perception, before: Belief, grid: OccupancyGrid, pose: Any, elapsed: Any
) -> Belief:
    """Return the belief with a new map and its fields."""
    clearance = clearance_field(find_closed_cells(grid, None), grid.frame, perception.max_clearance)
    belief = dataclasses.replace(before, grid=grid, clearance=clearance)
    return perception.update_fields(belief, pose, elapsed)


def _descent(
    values: np.ndarray, is_free: np.ndarray, start: tuple[int, int]
) -> Iterator[tuple[int, int]]:
    """Follow the cost-to-go from node to node until no neighbour is lower."""
    here = start
    while True:
        yield here
        best, lowest = here, values[here]
        for down, right in NEIGHBOURS:
            row, column = here[0] + down, here[1] + right
            if not (0 <= row < values.shape[0] and 0 <= column < values.shape[1]):
                continue
            # A diagonal step passes both cells beside it.
            if not (is_free[row, column] and is_free[here[0], column] and is_free[row, here[1]]):
                continue
            if values[row, column] < lowest:
                best, lowest = (row, column), values[row, column]
        if best == here:
            return
        here = best


def explorer_in(simulator: Any, **numbers: Any) -> Any:
    """Return the rule of `explorer` as an algorithm of the simulator.

    Args:
        simulator: the module that `load` returns.
        **numbers: parameters of `Perception`.
    """
    states = importlib.import_module("da.gridmaps").CellState

    class Explorer(simulator.NearestFrontier):  # type: ignore[misc]
        short_name = "jaxplore"

        def __init__(self, body: Any, state: Any) -> None:
            super().__init__(body, state)
            self.guide = Guide(float(body.world.scale), **numbers)

        def plan(self) -> None:
            # The nearest frontier is the way where little information is left. This raises the
            # simulator's own end when there is no frontier.
            super().plan()
            grid = np.asarray(self.state.grid)
            p = np.full(grid.shape, 0.5, np.float32)
            p[grid == states.FREE], p[grid == states.OCCUPIED] = 0.0, 1.0
            driven = float(self.state.cells_traveled) * self.guide.scale
            column, row = self.current_cell
            path = self.guide.path(p, (int(column), int(row)), driven)
            if len(path) > 1:
                self.planned_path = [self.state.position, *path]

    return Explorer


def explore(simulator: Any, algorithm: Any, start: Any, world: Any) -> dict[str, float]:
    """Run an algorithm from a start until no frontier is left."""
    body, state = world.start_state(start)
    run, began = algorithm(body, state), time.perf_counter()
    while True:
        try:
            run.plan()
        except simulator.ExplorationFinished:
            break
        run.refine()
        run.execute()
    return {
        "metres": float(run.state.cells_traveled * world.scale),
        "cells": float(run.state.grid.coverage),
        "plans": float(run.state.step),
        "seconds": time.perf_counter() - began,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Run rules from the ten starts."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.protocols.distance_advantage",
        description="Explore the office of lericson/da in its own simulator.",
    )
    parser.add_argument("clone", type=Path, metavar="CLONE", help="folder of a clone")
    parser.add_argument(
        "--rules", default="explorer,nearest-frontier", help=f"some of {', '.join(RULES)}"
    )
    parser.add_argument("--starts", type=int, default=NUM_STARTS, help="number of starts [10]")
    for name, value in PARAMETERS.items():
        parser.add_argument(
            f"--{name.replace('_', '-')}",
            type=float,
            default=value,
            help=f"{name} of our rule [{value:g}]",
        )
    parser.add_argument("--out", type=results_file, help="JSON file with all numbers")
    options = parser.parse_args(arguments)
    console = Console(width=140)
    try:
        rules = options.rules.split(",")
        if unknown := [rule for rule in rules if rule not in RULES]:
            raise ValueError(f"rules is {unknown[0]!r}; accepted: {', '.join(RULES)}")
        if not 1 <= options.starts <= NUM_STARTS:
            raise ValueError(f"starts is {options.starts}; accepted: 1 to {NUM_STARTS}")
        simulator = load(options.clone)
        algorithms = {
            "explorer": explorer_in(
                simulator, **{name: getattr(options, name) for name in PARAMETERS}
            ),
            "nearest-frontier": simulator.NearestFrontier,
            "distance-advantage": simulator.DistanceAdvantage,
            "information-gain": simulator.InformationGain,
        }
        rows = []
        for rule in rules:
            world = simulator.load_world()
            for index in range(1, options.starts + 1):
                start = world.start_locations[index - 1]
                found = explore(simulator, algorithms[rule], start, world)
                rows.append({"rule": rule, "start": index, **found})
                console.print(f"{rule}, start {index}: {found['metres']:.1f} m")
    except (ValueError, OSError) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        sys.exit(2)
    console.print(table("Metres until no frontier is left", summarise(rows)))
    if options.out is not None:
        replace_files([(options.out, (json.dumps(rows, indent=2) + "\n").encode())])


def summarise(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the mean and the standard deviation of the metres of each rule."""
    found = []
    for rule in dict.fromkeys(row["rule"] for row in rows):
        metres = np.array([row["metres"] for row in rows if row["rule"] == rule])
        found.append(
            {
                "rule": rule,
                "starts": len(metres),
                "mean": float(metres.mean()),
                "standard deviation": float(metres.std(ddof=1)) if len(metres) > 1 else 0.0,
            }
        )
    return found


if __name__ == "__main__":
    main()
