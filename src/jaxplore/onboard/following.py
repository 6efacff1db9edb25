"""Following of a path that another program plans, on the robot's own map."""

import itertools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter1d

from jaxplore._xla import on_device
from jaxplore.belief.perception import Perception
from jaxplore.costs.path_following import StopCost
from jaxplore.dynamics.augmented import Augmented
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.goal import GOAL_RADIUS, GOAL_TOLERANCE, STANDING, Goal, Motion
from jaxplore.dynamics.path_parameter import PathParameter
from jaxplore.geometry.curves import cusps
from jaxplore.geometry.path import Path
from jaxplore.onboard.tasks import DriveTask, TaskControl

NUM_NODES = 1025
"""Number of nodes of a path: paths of any length share a program."""
SPACING = 0.05
"""Distance between the points of a path that is smoothed [m]."""
SMOOTHING = 0.15
"""Standard deviation of the smoothing along the path [m]. Paths of planners on grids have corners
at every cell."""
SHOWN = 16
"""Every how many nodes of a path are shown in pictures."""
LEAST_LENGTH = 0.05
"""Least length of a path [m]."""
MOST_LENGTH = 10_000.0
"""Greatest length of a path [m]."""


class Following(DriveTask):
    """Drive along a path; at its end, and without one, the robot stands.

    Where the path turns back on itself, the robot comes to rest before it drives on: the path is
    followed in pieces from cusp to cusp.

    Args:
        perception: perception of the pilot.
        radius: distance from the end within which it is reached [m].
        tolerance: greatest error of the heading at an end that has one [rad].
    """

    has_fields = False

    def __init__(
        self,
        perception: Perception,
        radius: float = GOAL_RADIUS,
        tolerance: float = GOAL_TOLERANCE,
    ) -> None:
        super().__init__(perception)
        self.radius, self.tolerance = radius, tolerance
        self.max_speed = math.inf
        """Greatest speed, where it is less than that of the robot [m/s]."""
        self._pieces: list[Path] = []
        self._first = np.zeros(2)
        self._heading: float | None = None
        self._is_new = False
        self._path: Path | None = None
        self._goal = Goal(np.zeros(2))
        self._unlimited: TaskControl | None = None
        self._limit = math.inf

    @property
    def reference(self) -> np.ndarray:
        """Points (N, 2) of the path, relative to the origin of the belief [m]; none before it."""
        if self._path is None:
            return super().reference
        return np.asarray(self._path.points)[::SHOWN]

    def prepare(self, driver: TaskControl) -> None:
        """Compile what `update_control` calls."""
        other = Following(self.perception)
        other.take(np.array([[0.0, 0.0], [1.0, 0.0]]))
        other.update_control(driver, np.zeros(2), np.zeros(2, np.float32))

    def take(self, points: np.ndarray, heading: float | None = None) -> None:
        """Take a path, to be followed from the next command on.

        Args:
            points: (N, 2) points in the frame of the odometry [m].
            heading: heading at the end of the path [rad]; any when absent. It needs a controller
                with an `end_heading`, see `jaxplore.mpcc`.

        Raises:
            ValueError: as of `path_of_points`.
        """
        given = np.asarray(points, np.float64).reshape(-1, 2)
        # Far from the origin, single precision has centimetres only.
        first = given[0] if len(given) else np.zeros(2)
        self._pieces, self._first, self._heading = pieces_of_points(given - first), first, heading
        self._is_new = True

    def leave(self) -> None:
        """Leave the path: the robot brakes and stands until it gets another one."""
        self._is_new, self._path, self._pieces, self.is_done = False, None, [], False

    def update_control(
        self, driver: TaskControl, offset: np.ndarray, place: np.ndarray
    ) -> TaskControl:
        """Return a driver for the newest path, from its point that is nearest to the robot."""
        driver = self._limit_speed(driver)
        if not self._is_new:
            return driver
        self._is_new, path = False, self._pieces.pop(0)
        moved = (np.asarray(path.points, np.float64) + (self._first - offset)).astype(np.float32)
        path = eqx.tree_at(lambda each: each.points, path, on_device(moved))
        end = np.asarray(path.points[-1], np.float64)
        # In a cusp any heading is right.
        heading = None if self._pieces else self._heading
        self._goal = Goal(end, self.radius, heading, self.tolerance)
        self._path, self.is_done = path, False
        controller, robot = along_path((driver.controller, driver.robot), path, self._heading)
        expected = driver.expected.copy()
        expected[robot.state_names.index("phi")] = nearest_parameter(path, on_device(place))
        return TaskControl(controller, robot, expected)

    def waits_for(self, pose: np.ndarray, motion: Motion = STANDING) -> str:
        """Return why the robot stands; empty if it drives."""
        if self._path is None:
            return "" if self._is_new else "no path yet"
        if not self.is_done and not self._is_new and self._goal.is_reached(pose, motion):
            # At a cusp the next piece begins.
            self._is_new = bool(self._pieces)
            self.is_done = not self._is_new
        return "at the end of the path" if self.is_done else ""

    def _limit_speed(self, driver: TaskControl) -> TaskControl:
        if self._unlimited is None:
            self._unlimited = driver
        if self.max_speed == self._limit:
            return driver
        self._limit, whole = self.max_speed, self._unlimited
        given = driver.controller, driver.robot
        controller, robot = slowed(given, (whole.controller, whole.robot), self._limit)
        return TaskControl(controller, robot, driver.expected)


def pieces_of_points(points: np.ndarray) -> list[Path]:
    """Return the smooth paths along points (N, 2) [m] between cusps, see `path_of_points`."""
    given = np.asarray(points, np.float64).reshape(-1, 2)
    apart = np.ones(len(given), bool)
    apart[1:] = (np.diff(given, axis=0) != 0.0).any(axis=1)
    kept = given[apart]
    turns = cusps(kept) if len(kept) > 2 and np.isfinite(kept).all() else np.zeros(0, int)
    ends = [0, *turns.tolist(), len(kept) - 1]
    pieces = [kept[first : last + 1] for first, last in itertools.pairwise(ends)]
    long = [each for each in pieces if np.hypot(*np.diff(each, axis=0).T).sum() >= LEAST_LENGTH]
    # Points that make no path are refused as they were given.
    return [path_of_points(each) for each in (long if len(turns) and long else [given])]


def path_of_points(points: np.ndarray) -> Path:
    """Return a smooth open path along points (N, 2) [m].

    The points are joined by straight lines, which are resampled and smoothed by a Gaussian along
    the path. Both ends stay where they are.
    """
    given = np.asarray(points, np.float64).reshape(-1, 2)
    if not np.isfinite(given).all():
        raise ValueError("path has a point that is not finite; accepted: finite numbers")
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(given, axis=0).T))])
    if not (len(given) and LEAST_LENGTH <= along[-1] <= MOST_LENGTH):
        length = float(along[-1]) if len(given) else 0.0
        raise ValueError(
            f"path is {length:g} m long; accepted: {LEAST_LENGTH:g} to {MOST_LENGTH:g} m"
        )
    number = max(4, round(along[-1] / SPACING) + 1)
    even = np.linspace(0.0, along[-1], number)
    dense = np.stack([np.interp(even, along, column) for column in given.T], axis=-1)
    # Mirrored at its ends, a smoothed line still ends where it did.
    width = min(number - 1, math.ceil(4.0 * SMOOTHING / SPACING))
    padded = np.pad(dense, ((width, width), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = gaussian_filter1d(padded, SMOOTHING / SPACING, axis=0)[width:-width]
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(smooth, axis=0).T))])

    def position(phi: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(phi, arc, column) for column in smooth.T], axis=-1)

    pieces = np.diff(smooth, axis=0)
    pieces /= np.maximum(np.hypot(*pieces.T), 1e-12)[:, None]

    def direction(phi: np.ndarray) -> np.ndarray:
        step = 0.5 * SPACING
        chord = position(phi + step) - position(phi - step)
        size = np.hypot(*chord.T)[:, None]
        # Where the path turns back on itself, the chord vanishes.
        index = np.clip(np.searchsorted(arc, phi) - 1, 0, len(pieces) - 1)
        return np.where(size > 0.1 * step, chord / np.maximum(size, 1e-12), pieces[index])

    return Path(position, direction, float(arc[-1]), num_nodes=NUM_NODES)


def blank_path() -> Path:
    """Return the path with which a controller is compiled: of a metre along x."""
    return path_of_points(np.array([[0.0, 0.0], [1.0, 0.0]]))


def along_path[T](tree: T, path: Path, heading: float | None = None) -> T:
    """Return a controller or a model with another path of `NUM_NODES` nodes; all else stays.

    The heading at the end [rad] is that of a `StopCost` which has one.
    """

    def is_part(part: object) -> bool:
        return isinstance(part, (Path, PathParameter, StopCost))

    def replace(part: Any) -> Any:
        if isinstance(part, Path):
            return path
        if isinstance(part, PathParameter):
            return eqx.tree_at(lambda each: each.end, part, path.length)
        if isinstance(part, StopCost):
            part = eqx.tree_at(lambda each: each.path, part, path)
            if part.heading is not None and heading is not None:
                angle = on_device(np.asarray(heading, np.float32))
                part = eqx.tree_at(lambda each: each.heading, part, angle)
        return part

    changed: T = jax.tree.map(replace, tree, is_leaf=is_part)
    return changed


def slowed[T](tree: T, whole: T, limit: float) -> T:
    """Return a controller or a model whose robot, and its path parameter, obey a limit [m/s].

    `whole` is the same tree with the greatest speeds that are possible.
    """

    def has_speed(part: object) -> bool:
        return isinstance(part, Dynamics) and not isinstance(part, Augmented)

    def replace(part: Any, full: Any) -> Any:
        if not has_speed(part):
            return part
        bounds = {
            name: np.minimum(np.asarray(getattr(full, name)), np.float32(limit))
            for name in ("max_speed", "max_lateral_speed")
            if hasattr(full, name)
        }
        if hasattr(full, "min_speed"):
            bounds["min_speed"] = np.maximum(np.asarray(full.min_speed), np.float32(-limit))
        # The speed of some models is a control, as is the rate of the path parameter.
        is_speed = np.isin(full.control_names, ("v", "phi_rate"))
        if is_speed.any():
            low, high = np.asarray(full.control_min), np.asarray(full.control_max)
            bounds["control_min"] = np.where(is_speed, np.maximum(low, -limit), low)
            bounds["control_max"] = np.where(is_speed, np.minimum(high, limit), high)
        new = [on_device(np.asarray(each, np.float32)) for each in bounds.values()]
        return eqx.tree_at(lambda each: [getattr(each, name) for name in bounds], part, new)

    changed: T = jax.tree.map(replace, tree, whole, is_leaf=has_speed)
    return changed


@eqx.filter_jit
def nearest_parameter(path: Path, place: jax.Array) -> jax.Array:
    """Return the arc length of the point of a path that is nearest to a position (2,) [m]."""
    return jnp.asarray(path.nearest(place))
