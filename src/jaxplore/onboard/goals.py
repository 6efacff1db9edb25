"""Goals for a robot that another program drives: where on a map to look next."""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import Flag, Pose, Scalar
from jaxplore.belief.exploration_field import LEFTOVER_SHARE
from jaxplore.belief.perception import Perception
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.planning.strategy.frontiers import find_frontiers
from jaxplore.planning.strategy.target_rules import TargetRule

MOST_DROPPED = 32
"""Greatest number of goals that are dropped at a time; beyond it the oldest are tried again."""
MIN_FRONTIER = 0.0
"""Least length of a frontier [m]; any place with enough information is a goal."""
NUM_HEADINGS = 16
"""Number of headings that are compared at a goal."""


class ChosenGoal(NamedTuple):
    """A goal: a pose (x, y, yaw) in the frame of the map [m, m, rad].

    `distance` is the length of the path to it [m], `information` that of a scan there [nat].
    """

    pose: np.ndarray
    distance: float
    information: float


class _Chosen(NamedTuple):
    """The best node, on the device."""

    pose: Pose
    distance: Scalar
    information: Scalar
    has_goal: Flag


@eqx.filter_jit
def choose(
    perception: Perception,
    rule: TargetRule,
    grid: OccupancyGrid,
    pose: Pose,
    dropped: Float[Array, "N 3"],
    min_distance: Scalar,
) -> _Chosen:
    """Choose the node with the highest score of a rule; its path has at least `min_distance` [m].

    `dropped` (N, 3) has places (x, y) that are no goals, and the radius around each [m].
    """
    belief = perception.init(grid, pose)
    frontiers = find_frontiers(
        belief,
        pose,
        perception.locomotion,
        required_clearance=perception.required_clearance,
        min_information=perception.min_information,
        leftover_share=jnp.asarray(LEFTOVER_SHARE, jnp.float32),
        min_frontier=jnp.asarray(MIN_FRONTIER, jnp.float32),
        stride=perception.field_sensor.stride,
        near=1,
    )
    rows, columns = frontiers.distance.shape
    cells = jnp.stack(jnp.mgrid[:rows, :columns], axis=-1)
    places = belief.guidance.frame.cell_centre(cells)
    away = places[:, :, None] - dropped[:, :2]
    is_dropped = (jnp.hypot(away[..., 0], away[..., 1]) < dropped[:, 2]).any(axis=-1)
    may_be = rule.candidates(frontiers) & ~is_dropped & (frontiers.distance >= min_distance)
    scores = jnp.where(may_be, rule.scores(frontiers, key=jax.random.key(0)), -jnp.inf)
    row, column = jnp.unravel_index(jnp.argmax(scores), scores.shape)
    place = places[row, column]
    # A sensor that does not look around must face the information.
    headings = jnp.arange(NUM_HEADINGS, dtype=jnp.float32) * (2.0 * math.pi / NUM_HEADINGS)
    gains = jax.vmap(lambda heading: belief.information(place, heading))(headings)
    ahead = jnp.arctan2(place[1] - pose[1], place[0] - pose[0])
    yaw = ahead
    if not perception.sensors[0].is_full_circle:
        yaw = headings[jnp.argmax(gains)]
    return _Chosen(
        jnp.append(place, yaw),
        frontiers.distance[row, column],
        frontiers.worth[row, column],
        may_be.any(),
    )


class GoalChooser:
    """Chooses goals on the maps of another program, such as `slam_toolbox`, and drops bad ones.

    Maps may grow and move: they are padded to powers of two, so few sizes are compiled. What is
    free or occupied on them counts as known for certain, whatever the other program's probability.

    Args:
        perception: perception with the robot's clearance.
        rule: rule that scores the nodes.
        max_speed: speed of the robot [m/s].
        patience: time for which a goal is pursued, as a multiple of the time that its path needs.
        least_time: least time for which a goal is pursued [s].
        drop_time: time for which a goal that was not reached is dropped [s].
        near: distance at which a goal is reached [m].

    Raises:
        ValueError: a number that is not positive.
    """

    def __init__(
        self,
        perception: Perception,
        rule: TargetRule,
        *,
        max_speed: float,
        patience: float = 4.0,
        least_time: float = 15.0,
        drop_time: float = 60.0,
        near: float = 0.4,
    ) -> None:
        self.perception, self.rule = perception, rule
        self._speed = _checks.number("max_speed", max_speed, above=0.0)
        self._patience = _checks.number("patience", patience, above=0.0)
        self._least = _checks.number("least_time", least_time, above=0.0)
        self._drop_time = _checks.number("drop_time", drop_time, above=0.0)
        self._near = _checks.number("near", near, above=0.0)
        self._dropped: list[tuple[float, float, float]] = []
        self.goal: ChosenGoal | None = None
        self._reached: np.ndarray | None = None
        self._until = -math.inf
        self._offset = np.zeros(2)
        self.num_dropped = 0

    def update(
        self, now: float, grid: OccupancyGrid, offset: np.ndarray, pose: np.ndarray
    ) -> ChosenGoal | None:
        """Choose the goal for a map and a pose; None if no place is worth a visit.

        The goal stays the same until it is reached, takes too long, or is no longer worth a visit.

        Args:
            now: present time [s].
            grid: the map, relative to an offset.
            offset: (2,) position of that map's frame in the frame of the pose [m].
            pose: (3,) pose of the robot [m, m, rad].
        """
        self._dropped = [each for each in self._dropped if each[2] > now][-MOST_DROPPED:]
        if self.goal is not None and now > self._until and not self._is_near(pose):
            self.finish(now, is_reached=False)
        # A map that grows would compile anew at each size.
        padded = grid.settle().pad(power_of_two_shape(grid.shape))
        kept = None if self.goal is None or self._is_near(pose) else self._worth(padded, offset)
        if kept is not None and kept >= float(self.perception.min_information):
            return self.goal
        local = jnp.asarray(pose - np.append(offset, 0.0), jnp.float32)
        dropped = np.zeros((MOST_DROPPED, 3), np.float32)
        for index, (x, y, _) in enumerate(self._dropped):
            dropped[index] = x - offset[0], y - offset[1], 2.0 * self._near
        found = choose(
            self.perception,
            self.rule,
            padded,
            local,
            jnp.asarray(dropped),
            jnp.asarray(self._near, jnp.float32),
        )
        if not bool(found.has_goal):
            self.goal = None
            return None
        place = np.asarray(found.pose, np.float64) + np.append(offset, 0.0)
        self.goal = ChosenGoal(place, float(found.distance), float(found.information))
        if self._reached is not None and math.dist(place[:2], self._reached[:2]) <= self._near:
            # A robot that stands there, as far as its driver knows, learns nothing more there.
            self.finish(now, is_reached=False)
            return self.update(now, grid, offset, pose)
        self._reached = None
        self._until = now + max(self._least, self._patience * self.goal.distance / self._speed)
        return self.goal

    def finish(self, now: float, *, is_reached: bool) -> None:
        """Give the present goal up, as who drives says: for ever, or for a while if he failed.

        Args:
            now: present time [s].
            is_reached: whether it is reached; it is not chosen again at once.
        """
        if self.goal is None:
            return
        self._reached = None
        if is_reached:
            self._reached = self.goal.pose
        else:
            self._dropped.append((*self.goal.pose[:2].tolist(), now + self._drop_time))
            self.num_dropped += 1
        self.goal = None

    def _is_near(self, pose: np.ndarray) -> bool:
        assert self.goal is not None
        return math.hypot(*(pose[:2] - self.goal.pose[:2])) <= self._near

    def _worth(self, grid: OccupancyGrid, offset: np.ndarray) -> float:
        """Return the information of a scan at the goal now [nat]."""
        assert self.goal is not None
        place = jnp.asarray(self.goal.pose[:2] - offset, jnp.float32)
        return float(_information_at(self.perception, grid, place))


@eqx.filter_jit
def _information_at(perception: Perception, grid: OccupancyGrid, place: Array) -> Scalar:
    sensor, model = perception.field_sensor, perception.sensor_model
    prior = perception.occupancy_prior
    if sensor.doubling is None:
        # A node at the place alone, whose cost does not grow with the map.
        return sensor.window(grid, model, place, (1, 1), prior=prior).total[0, 0]
    field = sensor.field(grid, model, prior=prior)
    row, column = field.frame.to_cell(place)
    rows, columns = field.total.shape
    is_there = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    return jnp.where(is_there, field.total[row, column], 0.0)


def power_of_two_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the smallest powers of two, at least 64, that hold a number of rows and columns."""
    rows, columns = (max(64, 1 << (side - 1).bit_length()) for side in shape)
    return rows, columns
