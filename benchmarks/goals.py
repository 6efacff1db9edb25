"""`python -m benchmarks.goals`: drives to goals on known maps, by several robots.

Every drive ends when the goal is reached (`Goal`), or after a minute. Maps are generated, and
those of `JAXPLORE_MAPS` are added; all are cut to one size, so that a robot needs one program.
"""

import argparse
import functools
import json
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxplore as jx
from benchmarks.history import results_file
from benchmarks.tables import Rows, markdown
from jaxplore.belief import Belief
from jaxplore.belief.car import car_motion
from jaxplore.control import Controller
from jaxplore.dynamics.goal import Goal, Motion
from jaxplore.maps.collision import clearance_reach, footprint_clearance
from jaxplore.maps.files.ros import read_map
from jaxplore.maps.generators.generated import KINDS
from jaxplore.simulation.exploration.reachability import open_spot, reachable_cells

SIDE, RESOLUTION = 240, 0.1
"""Cells of a side of the maps, and their size [m]."""
NEAREST, FARTHEST = 3.0, 9.0
"""Least and greatest straight distance from a start to a goal [m]."""
ROOM = 0.15
"""Free distance around a robot at a start and at a goal [m]."""
PERIOD, FLIGHT_PERIOD, SECONDS = 0.05, 0.02, 60.0
"""Control periods on the ground and in the air, and the longest time of a drive [s]."""
NUM_SAMPLES = 256


class Drive(NamedTuple):
    """The end of a drive.

    Args:
        is_reached: whether the goal is reached.
        steps: number of control periods.
        error: distance from the goal [m].
        turn: difference from the heading at the goal [rad]; 0 where any will do.
        clearance: least distance of the robot's edge from what is not free [m].
        beyond: greatest distance from the goal after the robot was first within its radius [m].
    """

    is_reached: Array
    steps: Array
    error: Array
    turn: Array
    clearance: Array
    beyond: Array


class Kind(NamedTuple):
    """A robot, its controller, its control period [s], and z of its states [m]."""

    robot: jx.Dynamics
    controller: Controller
    period: Any = PERIOD
    height: Any = 0.0


def kinds() -> dict[str, Kind]:
    """Return the robots."""
    flight = jx.planning.Flight(control_period=FLIGHT_PERIOD, altitude=-2.0)
    quadrotor = jx.Quadrotor()
    flown = flight.cost(quadrotor) + 10.0 * jx.GuidanceCost()
    ground = {
        "differential drive": jx.DifferentialDrive(),
        "weak brakes": jx.DifferentialDrive(max_acceleration=0.3),
        "omnidirectional": jx.Omnidirectional(),
        "point mass": jx.PointMass(max_speed=1.0),
        "car": jx.Ackermann(max_speed=1.0, min_speed=-0.5),
    }
    made = {
        name: Kind(robot, jx.explorer(robot, num_samples=NUM_SAMPLES, dt=PERIOD))
        for name, robot in ground.items()
    }
    made["quadrotor"] = Kind(quadrotor, flight.mppi(quadrotor, flown), FLIGHT_PERIOD, -2.0)
    return made


def scenes() -> dict[str, np.ndarray]:
    """Return 20 maps, or 14 without `JAXPLORE_MAPS`: probabilities of occupancy (SIDE, SIDE)."""
    found = {}
    for kind in KINDS:
        for seed in (1, 2):
            grid = jx.maps.generate_map(kind, seed).resample(RESOLUTION)
            found[f"{kind} {seed}"] = np.asarray(grid.probability)
    root = os.environ.get("JAXPLORE_MAPS")
    files = sorted(Path(root).glob("*/*.yaml")) if root else []
    for path in files[:6]:
        grid = jx.OccupancyGrid(*read_map(path)).resample(RESOLUTION)
        found[path.parent.name] = np.asarray(grid.probability)
    return {name: _cut(cells) for name, cells in found.items()}


def _cut(cells: np.ndarray) -> np.ndarray:
    """Return the part of a map around its widest place, with walls where there is none."""
    grid = jx.OccupancyGrid(cells, RESOLUTION)
    x, y = open_spot(grid, 0.3)
    low = [max(0, min(round(at / RESOLUTION) - SIDE // 2, side - SIDE))
           for at, side in zip((y, x), cells.shape, strict=True)]  # fmt: skip
    part = cells[low[0] : low[0] + SIDE, low[1] : low[1] + SIDE]
    whole = np.ones((SIDE, SIDE), np.float32)
    whole[: part.shape[0], : part.shape[1]] = part
    whole[[0, -1]] = whole[:, [0, -1]] = 1.0
    return whole


def places(cells: np.ndarray, robot: jx.Dynamics, number: int, seed: int) -> np.ndarray:
    """Return starts and goals (number, 6): x, y, yaw, and x, y, yaw of the goal.

    A rectangle fits at both with its heading. A disc fits at any.
    """
    radius = float(robot.radius)
    grid = jx.OccupancyGrid(cells, RESOLUTION)
    spot = np.array([*open_spot(grid, radius + ROOM), 0.0])
    free = np.argwhere(reachable_cells(grid, spot, radius + ROOM))
    rng, turns = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    rows: list[list[float]] = []
    # In a room that is too small for the robot, the goals are nearer.
    nearest = min(NEAREST, 0.5 * RESOLUTION * np.hypot(*np.ptp(free, axis=0)))
    while len(rows) < number:
        start, goal = (RESOLUTION * (free[rng.integers(len(free))][::-1] + 0.5) for _ in range(2))
        if nearest <= np.hypot(*(goal - start)) <= FARTHEST:
            row = [*start, rng.uniform(-np.pi, np.pi), *goal, turns.uniform(-np.pi, np.pi)]
            if fits(grid, robot, row[:3]) and fits(grid, robot, row[3:]):
                rows.append(row)
    return np.array(rows, np.float32)


def fits(grid: jx.OccupancyGrid, robot: jx.Dynamics, pose: Sequence[float]) -> bool:
    """Check whether a robot that is a rectangle touches nothing at a pose (x, y, yaw)."""
    footprint = robot.footprint
    if not isinstance(footprint, jx.Rectangle):
        return True
    solid, reach = ~grid.is_free, clearance_reach(footprint, RESOLUTION)
    x, y, heading = jnp.asarray(pose, jnp.float32)
    gap = footprint_clearance(solid, grid.frame, jnp.stack([x, y]), heading, footprint, reach)
    return float(gap) > 0.0


@eqx.filter_jit
def drive(
    kind: Kind,
    perception: jx.Perception,
    cells: np.ndarray,
    place: Array,
    seed: Array,
) -> Drive:
    """Drive from a start to a goal on a known map, to its heading if the perception has one."""
    start, goal = place[:3], place[3:5]
    perception = eqx.tree_at(lambda each: each.goal, perception, goal)
    heading = None
    if perception.goal_heading is not None:
        heading = place[5]
        perception = eqx.tree_at(lambda each: each.goal_heading, perception, heading)
    belief: Belief = perception.init(jx.OccupancyGrid(cells, RESOLUTION), start)
    robot, controller, period, height = kind
    check = Goal.of(goal, heading=heading)

    def goes_on(carry: Any) -> Array:
        so_far: Drive = carry[2]
        is_early: Array = so_far.steps * period < SECONDS
        return ~so_far.is_reached & is_early

    def step(carry: Any) -> Any:
        memory, state, so_far = carry
        key = jax.random.fold_in(jax.random.key(seed), so_far.steps)
        pose = robot.pose(state)
        here = eqx.tree_at(
            lambda each: (each.pose, each.guidance),
            belief,
            (pose, belief.guidance.from_pose(pose)),
        )
        control, memory, _ = controller.step(memory, state, here, key=key)
        after = robot.step(state, control, period)
        error = jnp.linalg.norm(robot.position(after) - goal)
        reached = check.is_reached(robot.pose(after), Motion.between(robot, state, after, period))
        clearance = belief.clearance(robot.position(after)) - robot.radius
        was_there = so_far.beyond >= 0.0
        beyond = jnp.where(was_there, jnp.maximum(so_far.beyond, error), so_far.beyond)
        beyond = jnp.where(was_there | (error > check.radius), beyond, error)
        clearance = jnp.minimum(so_far.clearance, clearance)
        turn = jnp.zeros(())
        if heading is not None:
            away = robot.pose(after)[2] - heading
            turn = jnp.abs(jnp.arctan2(jnp.sin(away), jnp.cos(away)))
        return memory, after, Drive(reached, so_far.steps + 1, error, turn, clearance, beyond)

    state = robot.at_pose(0.0, 0.0, 0.0)
    state = robot.with_pose(state, start)
    if "z" in robot.state_names:
        state = robot.with_component(state, "z", height)
    nothing = Drive(
        jnp.array(False),
        jnp.zeros((), int),
        *(jnp.zeros(()), jnp.zeros(()), jnp.full((), jnp.inf), -jnp.ones(())),
    )
    driven: Drive = jax.lax.while_loop(goes_on, step, (controller.init(), state, nothing))[2]
    return driven


def measure(
    names: list[str], number: int, num_scenes: int, *, has_heading: bool = False
) -> dict[str, list[dict[str, Any]]]:
    """Return the drives of each robot, `number` on each map."""
    lidar = jx.Lidar()
    results: dict[str, list[dict[str, Any]]] = {}
    maps = dict(list(scenes().items())[:num_scenes])
    for name in names:
        kind = kinds()[name]
        kind = kind._replace(period=jnp.asarray(kind.period), height=jnp.asarray(kind.height))
        robot = kind.robot
        perception = jx.Perception(
            lidar,
            RESOLUTION,
            robot.radius,
            goal=(0.0, 0.0),
            goal_heading=0.0 if has_heading else None,
            max_unknown=1.0,
            car=car_motion(robot),
        ).for_batches()
        rows = results[name] = []
        for index, (scene, cells) in enumerate(maps.items()):
            given = places(cells, robot, number, index)
            began = time.process_time()
            batch = functools.partial(drive, kind, perception, cells)
            found = jax.tree.map(np.asarray, eqx.filter_vmap(batch)(given, jnp.arange(number)))
            for values in zip(*found, strict=True):
                rows.append(
                    {"scene": scene, **dict(zip(Drive._fields, map(float, values), strict=True))}
                )
            cost = f"{time.process_time() - began:.1f} s of CPU"
            print(name, scene, found.is_reached, found.error.round(3), cost, flush=True)
    return results


def rows_of(results: dict[str, list[dict[str, Any]]]) -> Rows:
    """Return a row for each robot."""
    rows = []
    for name, drives in results.items():
        error = np.array([each["error"] for each in drives])
        at = kinds()[name].period * np.array([each["steps"] for each in drives])
        rows.append(
            {
                "robot": name,
                "reached": f"{sum(each['is_reached'] for each in drives):.0f} of {len(drives)}",
                "rest error [m], median": round(float(np.median(error)), 3),
                "greatest": round(float(error.max()), 3),
                "of the heading [rad]": round(max(each["turn"] for each in drives), 3),
                "farthest after arrival [m]": round(max(each["beyond"] for each in drives), 2),
                "time [s], median": round(float(np.median(at)), 1),
                "contacts": sum(each["clearance"] < -0.5 * RESOLUTION for each in drives),
            }
        )
    return rows


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=list(kinds()), choices=list(kinds()))
    parser.add_argument("--seeds", type=int, default=5, help="drives on each map")
    parser.add_argument("--scenes", type=int, default=20, help="number of maps")
    parser.add_argument("--heading", action="store_true", help="goals have a heading")
    parser.add_argument("--out", type=results_file, help="JSON file for the drives")
    given = parser.parse_args()
    results = measure(given.robots, given.seeds, given.scenes, has_heading=given.heading)
    if given.out is not None:
        given.out.write_text(json.dumps(results, indent=1))
    print(markdown(rows_of(results)))


if __name__ == "__main__":
    main()
