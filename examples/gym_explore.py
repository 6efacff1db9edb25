"""Planners of one's own against jaxplore's, through Gymnasium's interface.

The same robot explores the same unknown office three times: towards the nearest frontier, from
place to place at random, and as jaxplore's explorer drives it. The first two know nothing of
jaxplore but the environment's observations and spaces.
"""

import sys
from collections import deque
from collections.abc import Callable, Iterator

import gymnasium
import jax
import numpy as np
from scipy import ndimage

import jaxplore as jx

ENVIRONMENT = "jaxplore.gym:jaxplore/Exploration-v0"
OFFICE = {"office": {"seed": 0, "width": 12.0, "height": 8.0}, "target_coverage": 0.95}
TIME_LIMIT, SEED = 120.0, 0
TIMES = (10, 20, 40, 60, 120)
WIDTH, SMALLEST, NEAR = 0.3, 4, 0.6
"""Room that a way has on either side [m], least frontier [cells], and how near a way ends [m]."""

Observed = dict[str, np.ndarray]
Policy = Callable[[Observed], np.ndarray]
Curve = list[tuple[float, float]]


def frontier_policy(environment: gymnasium.Env) -> Policy:
    """Return a policy that goes to the nearest place from which a frontier is seen."""
    poses, shape = environment.observation_space["pose"], environment.observation_space["belief"]
    origin = poses.low[:2]
    resolution = float((poses.high[0] - origin[0]) / shape.shape[1])
    reach = float(environment.action_space.high[0])

    def decide(observation: Observed) -> np.ndarray:
        belief, (x, y, yaw) = observation["belief"], observation["pose"]
        is_free, is_solid = belief < 0.25, belief > 0.65
        # What is unknown beside a wall is the wall, as a rule.
        is_unknown = ~is_free & ~ndimage.binary_dilation(is_solid, np.ones((3, 3)))
        frontier = is_free & ndimage.binary_dilation(is_unknown)
        clusters, _ = ndimage.label(frontier, np.ones((3, 3)))
        frontier &= np.bincount(clusters.ravel())[clusters] >= SMALLEST
        room = resolution * ndimage.distance_transform_edt(is_free)
        to_frontier, nearest = ndimage.distance_transform_edt(~frontier, return_indices=True)
        here = (int((y - origin[1]) / resolution), int((x - origin[0]) / resolution))
        way = path(room > WIDTH, here, (resolution * to_frontier < NEAR) & frontier.any())
        if frontier.any():
            way.append((int(nearest[0][way[-1]]), int(nearest[1][way[-1]])))
        offsets = (np.array(way)[:, ::-1] + 0.5) * resolution + origin - [x, y]
        # As far along the way as an action goes.
        offset = offsets[np.flatnonzero(np.hypot(*offsets.T) < reach)[-1]]
        cos, sin = np.cos(yaw), np.sin(yaw)
        return np.array([[cos, sin], [-sin, cos]]) @ offset

    return decide


def path(is_open: np.ndarray, start: tuple[int, int], is_end: np.ndarray) -> list[tuple[int, int]]:
    """Return the cells of a shortest way to an end, the start alone if there is none."""
    before: dict[tuple[int, int], tuple[int, int] | None] = {start: None}
    queue = deque([start])
    while queue:
        cell = queue.popleft()
        if is_end[cell] and is_open[cell]:
            way = [cell]
            while (step := before[way[-1]]) is not None:
                way.append(step)
            return way[::-1]
        row, column = cell
        for after in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
            # Who stands too close to a wall may leave it.
            if after not in before and (is_open[after] or not is_open[cell]):
                before[after] = cell
                queue.append(after)
    return [start]


def explore(environment: gymnasium.Env, policy: Policy) -> tuple[Curve, dict[str, float]]:
    """Return coverage over time and the facts at the end of an episode."""
    observation, info = environment.reset(seed=SEED)
    curve, is_over = [(info["time"], info["coverage"])], False
    while not is_over:
        observation, _, terminated, truncated, info = environment.step(policy(observation))
        curve.append((info["time"], info["coverage"]))
        is_over = terminated or truncated
    return curve, info


def rows() -> Iterator[tuple[str, Curve, float, int]]:
    """Yield the name of each planner, coverage over time, path length [m] and contacts."""
    environment = gymnasium.make(ENVIRONMENT, action="waypoint", time_limit=TIME_LIMIT, **OFFICE)
    environment.action_space.seed(SEED)
    policies = {
        "nearest frontier": frontier_policy(environment),
        "random places": lambda _: environment.action_space.sample(),
    }
    for name, policy in policies.items():
        curve, info = explore(environment, policy)
        yield name, curve, info["path_length"], int(info["collisions"])
    # The same scenario and the same key, in jaxplore's own closed loop.
    scenario = environment.unwrapped.environment.scenario(0)
    steps = round(TIME_LIMIT / float(scenario.control_period))
    controller = jx.explorer(scenario.robot, num_samples=256)
    run = jx.simulate(
        controller, scenario, steps, key=jax.random.key(SEED), num_trajectories=0, progress=False
    )
    period = run.recording.control_period
    curve = [(k * period, float(c)) for k, c in enumerate(run.recording.records.coverage)]
    yield "jaxplore's explorer", curve, run.metrics.path_length, run.metrics.collisions


if __name__ == "__main__":
    heads = [f"{time:>4} s" for time in TIMES]
    sys.stdout.write(f"{'coverage after':20} {' '.join(heads)}   path [m]  contacts\n")
    for name, curve, length, contacts in rows():
        shares = [[share for time, share in curve if time <= limit][-1] for limit in TIMES]
        cells = " ".join(f"{share:>6.1%}" for share in shares)
        sys.stdout.write(f"{name:20} {cells}   {length:8.1f}  {contacts:8d}\n")
