"""Merging of maps whose frames nobody knows: how many are found, how many are wrong, how long."""

import argparse
import json
import math
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from benchmarks.history import results_file
from benchmarks.map_pairs import Seen, Site, shared_area, true_pose
from benchmarks.setting import available_maps
from benchmarks.tables import Rows, table
from benchmarks.timing import percentiles
from jaxplore.localisation.map_matching import MapMatch, match_maps
from jaxplore.maps.generators.office import office
from jaxplore.maps.occupancy_grid import OccupancyGrid

SITES = {
    "nav2_depot": "nav2_depot/depot.yaml",
    "aws_small_warehouse_005": "aws_small_warehouse_005/map.yaml",
    "nav2_warehouse": "nav2_warehouse/warehouse.yaml",
    "willow_garage_010": "willow_garage_010/willow-2010-02-18-0.10.yaml",
}
MUCH = 0.4
"""Share of the free area of the smaller map from which on two maps overlap much."""
WRONG, WRONG_YAW = 0.3, 0.05
"""Errors of a pose in the middle of a map from which on it is wrong [m, rad]."""
FINEST = 0.05
"""Least side of a cell of a world; finer ones are coarsened [m]."""


class Sizes(NamedTuple):
    """Maps, robots and ways on each [m], pairs on each map of much overlap, of less, and pairs with
    another map, the range of the lidar [m], and its beams."""

    maps: tuple[str, ...] = tuple(available_maps(SITES))
    robots: int = 10
    ways: tuple[float, ...] = (25.0, 50.0, 90.0)
    much: int = 25
    less: int = 25
    others: int = 25
    max_range: float = 5.0
    num_beams: int = 360


FULL = Sizes()
SMOKE = Sizes(("office",), 2, (12.0,), 1, 1, 1, 5.0, 90)
TITLES = {
    "pairs": "Maps of two robots in frames that nobody knows",
    "errors": "Errors and times of the poses that are certain",
}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return how many pairs of maps are found, and errors and times of the matches."""
    rng = np.random.default_rng(0)
    seen = {name: _explore(name, sizes) for name in sizes.maps}
    pairs: Rows = []
    errors: Rows = []
    for name, robots in seen.items():
        much, less = _draw_pairs(robots, sizes, rng)
        rest = [each for other, maps in seen.items() if other != name for each in maps]
        found = [_match(*pair) for pair in much]
        fewer = [_match(*pair) for pair in less]
        others = [
            match_maps(robots[rng.integers(len(robots))][1].grid, rest[index][1].grid)
            for index in rng.integers(len(rest), size=sizes.others if rest else 0)
        ]
        pairs.append(
            {
                "map": name,
                "pairs": len(much),
                "found": sum(each.is_right for each in found),
                "wrong": sum(each.is_wrong for each in found),
                "less overlap": len(less),
                "of them found": sum(each.is_right for each in fewer),
                "of them wrong": sum(each.is_wrong for each in fewer),
                "other buildings": len(others),
                "merged": sum(each.is_certain for each in others),
            }
        )
        right = [each for each in (*found, *fewer) if each.is_right]
        if right:
            errors.append(_summary(name, right))
    return {"pairs": pairs, "errors": errors}


class _Outcome(NamedTuple):
    """A match, the errors of its pose [m, rad], its normalised squared error and its time [s]."""

    match: MapMatch
    error: float
    yaw: float
    squared: float
    seconds: float

    @property
    def is_wrong(self) -> bool:
        return self.match.is_certain and (self.error > WRONG or self.yaw > WRONG_YAW)

    @property
    def is_right(self) -> bool:
        return self.match.is_certain and not self.is_wrong


def _summary(name: str, right: Sequence[_Outcome]) -> dict[str, Any]:
    away = np.array([each.error for each in right])
    return {
        "map": name,
        "rms_m": float(np.sqrt((away**2).mean())),
        "greatest_m": float(away.max()),
        "rms_yaw_mrad": 1e3 * float(np.sqrt(np.mean([each.yaw**2 for each in right]))),
        "mean_squared": float(np.mean([each.squared for each in right])),
        **percentiles([each.seconds for each in right]),
    }


def _explore(name: str, sizes: Sizes) -> list[tuple[int, Seen]]:
    """Return the number of the robot and the map, of all robots and ways on a map."""
    path = available_maps(SITES).get(name)
    if name == "office" or path is None:
        world = office(width=9.0, height=8.0)
    else:
        world = OccupancyGrid.from_ros(path)
    if world.resolution < FINEST:
        world = world.resample(FINEST)
    site = Site(world, max_range=sizes.max_range, num_beams=sizes.num_beams)
    return [
        (robot, seen)
        for robot in range(sizes.robots)
        for seen in site.explore(sizes.ways, np.random.default_rng([7, robot]))
    ]


def _draw_pairs(
    robots: list[tuple[int, Seen]], sizes: Sizes, rng: np.random.Generator
) -> tuple[list[tuple[Seen, Seen]], list[tuple[Seen, Seen]]]:
    """Return random pairs of maps of different robots that overlap much, and that overlap less."""
    every = [(one, other) for first, one in robots for second, other in robots if first != second]
    much: list[tuple[Seen, Seen]] = []
    less: list[tuple[Seen, Seen]] = []
    for index in rng.permutation(len(every)):
        if len(much) >= sizes.much and len(less) >= sizes.less:
            break
        kind, number = (
            (much, sizes.much) if shared_area(*every[index])[1] >= MUCH else (less, sizes.less)
        )
        if len(kind) < number:
            kind.append(every[index])
    return much, less


def _match(one: Seen, other: Seen) -> _Outcome:
    start = time.process_time()
    match = match_maps(one.grid, other.grid)
    seconds = time.process_time() - start
    true = true_pose(one, other)
    # In the middle of the other map: its frame may be far away.
    middle = np.asarray(other.grid.frame.to_world(0.5 * jnp.asarray(other.grid.shape, jnp.float32)))
    error = match.pose - true
    error[2] = math.remainder(error[2], math.tau)
    away = _placed(match.pose, middle) - _placed(true, middle)
    squared = math.inf
    if np.isfinite(match.covariance).all():
        squared = float(error @ np.linalg.solve(match.covariance, error))
    return _Outcome(match, float(np.hypot(*away)), abs(float(error[2])), squared, seconds)


def _placed(pose: np.ndarray, point: np.ndarray) -> np.ndarray:
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(pose[:2] + np.array([[cos, -sin], [sin, cos]]) @ point)


def main() -> None:
    """Measure what the command line asks for."""
    from rich.console import Console

    parser = argparse.ArgumentParser(prog="python -m benchmarks.map_matching", description=__doc__)
    parser.add_argument("--maps", nargs="*", choices=list(available_maps(SITES)))
    parser.add_argument("--range", type=float, default=FULL.max_range, help="of the lidar [m]")
    parser.add_argument("--out", type=results_file, help="JSON file of the rows")
    choice, console = parser.parse_args(), Console(width=180)
    sizes = FULL._replace(maps=tuple(choice.maps or FULL.maps), max_range=choice.range)
    found = measure(sizes)
    for key, title in TITLES.items():
        console.print(table(title, found[key]))
    if choice.out is not None:
        choice.out.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
