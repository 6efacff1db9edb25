"""What every estimator of a robot's pose has: by scans while it maps, or on a known map."""

import abc
from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
from jaxtyping import Array, Float

from jaxplore._types import Count, Flag, Key, Pose, Scalar
from jaxplore.localisation.odometry_model import ErrorEstimate, OdometryModel
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.beams import Beams, Scan


@runtime_checkable
class WayPoints(Protocol):
    """Poses along the way of a robot, in arrays with room for K of them."""

    @property
    def poses(self) -> Float[Array, "K 3"]:
        """Estimated poses (K, 3), of which the first `number` count [m, m, rad]."""

    @property
    def way(self) -> Float[Array, " K"]:
        """Length of the robot's way up to each [m]."""

    @property
    def number(self) -> Count:
        """Number of poses."""

    @property
    def capacity(self) -> int:
        """Greatest number of poses."""

    @property
    def last(self) -> Count:
        """Index of the newest pose; 0 without any."""


@runtime_checkable
class PoseState(Protocol):
    """What an estimator knows of the pose."""

    @property
    def pose(self) -> Pose:
        """Most likely pose (x, y, yaw) [m, m, rad]."""

    @property
    def is_known(self) -> Flag:
        """Whether the robot may drive and map by this pose."""

    @property
    def uncertainty(self) -> Scalar:
        """Standard deviation of the position [m]."""

    @property
    def share(self) -> Scalar:
        """How much of the newest scan fits what the robot knows, in [0, 1]."""

    @property
    def scans(self) -> WayPoints:
        """Poses along the way, at scans that were stored."""

    @property
    def errors(self) -> ErrorEstimate | None:
        """What is known of the odometry's errors; None where nothing is estimated of them."""


class PoseEstimator(eqx.Module):
    """Estimates the pose of a robot by its odometry and its scans.

    Each state that a method returns is a `PoseState`.

    Attributes:
        is_mapping: whether it makes a map from the scans. Such an estimator gets no scan that does
            not fit the robot's map; another one gets all.
    """

    is_mapping: eqx.AbstractClassVar[bool]

    @property
    @abc.abstractmethod
    def expected_odometry(self) -> OdometryModel:
        """Errors of the odometry that it expects."""

    @abc.abstractmethod
    def check_map(self, prior: OccupancyGrid | None) -> None:
        """Check that the map that the robot knows in advance is one to find a pose on.

        Args:
            prior: that map; None if it knows nothing.

        Raises:
            ValueError: a map without which the estimator knows no pose.
        """

    @abc.abstractmethod
    def start(
        self, pose: Pose, grid: OccupancyGrid, sensors: Sequence[Beams], key: Key | None
    ) -> Any:
        """Return the state at the start.

        Args:
            pose: pose (x, y, yaw) at the start [m, m, rad].
            grid: map of the belief at the start.
            sensors: the sensors, of which the first one tells the pose.
            key: random key of the run; nothing depends on the run when absent.
        """

    @abc.abstractmethod
    def predict(self, state: Any, motion: Pose, elapsed: Scalar) -> Any:
        """Return the state after a motion.

        Args:
            state: state before it.
            motion: motion (dx, dy, dyaw) by the odometry, in the frame of the robot [m, m, rad].
            elapsed: time that it took [s].
        """

    @abc.abstractmethod
    def correct(self, state: Any, scans: Sequence[Scan], sensors: Sequence[Beams]) -> Any:
        """Return the state after scans.

        Args:
            state: state before them.
            scans: a scan of each sensor.
            sensors: the sensors.
        """
