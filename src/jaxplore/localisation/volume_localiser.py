"""Where a robot in a volume is: odometry between scans, and matching of scans."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxplore import _kinds
from jaxplore._types import Scalar
from jaxplore.geometry.level_motion import LevelMatrix, LevelPose, compose, propagate_covariance
from jaxplore.localisation.localiser import LEAST_MATCHED
from jaxplore.localisation.volume_matching import VolumeMatcher
from jaxplore.localisation.volume_odometry import VolumeOdometry
from jaxplore.localisation.volume_surface import VolumePoints, VolumeSurface
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.sensing.volume import Rotation, VolumeScan, VolumeSensor

FLOOR = (0.001, 0.001, 0.001, 0.0002)
"""Least standard deviations of a pose before the first motion [m, m, m, rad]."""


class VolumeLocaliserState(NamedTuple):
    """What a localiser in a volume knows.

    Args:
        pose: estimated pose (x, y, z, yaw) with z up [m, m, m, rad].
        covariance: (4, 4) its covariance relative to the map, in the world.
        surface: surfaces that were seen.
        share: share of the newest scans that lies on known surfaces.
    """

    pose: LevelPose
    covariance: LevelMatrix
    surface: VolumeSurface
    share: Scalar


class VolumeLocaliser(eqx.Module):
    """Estimates position and yaw of a robot in a volume by odometry and scans, while it maps.

    As `Localiser` in the plane, without closed loops: all surfaces that were seen stay
    (`VolumeSurface`), so that what comes into view again corrects the pose. Roll and pitch are
    taken as measured: gravity tells them.

    Source: to fly by the distances of a map of surfaces: Sturm et al., "Dense tracking and mapping
    with a quadrocopter", UAV-g 2013.

    Args:
        odometry: errors of the odometry; those of `VolumeOdometry` when absent.
        matcher: matches scans; with the default numbers when absent.

    Raises:
        ValueError: a part of another class.
    """

    odometry: VolumeOdometry
    matcher: VolumeMatcher

    @_kinds.check_arguments
    def __init__(
        self, odometry: VolumeOdometry | None = None, *, matcher: VolumeMatcher | None = None
    ) -> None:
        self.odometry = VolumeOdometry() if odometry is None else odometry
        self.matcher = VolumeMatcher() if matcher is None else matcher

    def init(self, pose: LevelPose, grid: VoxelGrid) -> VolumeLocaliserState:
        """Return the state at the start.

        Args:
            pose: pose (x, y, z, yaw) of the start, which defines the frame of the map.
            grid: map of the belief at the start.
        """
        covariance = jnp.diag(jnp.array(FLOOR) ** 2)
        return VolumeLocaliserState(pose, covariance, VolumeSurface.empty(grid), jnp.zeros(()))

    def predict(self, state: VolumeLocaliserState, motion: LevelPose) -> VolumeLocaliserState:
        """Return the state after a motion.

        Args:
            state: state before it.
            motion: motion (dx, dy, dz, dyaw) by the odometry, in the level frame of the robot.
        """
        added = self.odometry.covariance(motion)
        covariance = propagate_covariance(state.pose, motion, state.covariance, added)
        return state._replace(pose=compose(state.pose, motion), covariance=covariance)

    def correct(
        self,
        state: VolumeLocaliserState,
        scans: Sequence[VolumeScan],
        sensors: Sequence[VolumeSensor],
        level: Rotation,
    ) -> VolumeLocaliserState:
        """Return the state after scans: the pose corrected, and their surfaces added.

        Args:
            state: state before the scans.
            scans: a scan of each sensor.
            sensors: the sensors.
            level: rotation from the body to a level frame that is turned as the robot: its roll and
                pitch.
        """
        ends = VolumePoints.of(sensors, scans, level)
        match = self.matcher(state.surface, ends, state.pose, state.covariance)
        is_matched = match.number >= LEAST_MATCHED
        pose = jnp.where(is_matched, match.pose, state.pose)
        covariance = jnp.where(is_matched, match.covariance, state.covariance)
        surface = state.surface.with_scan(pose, ends)
        return VolumeLocaliserState(pose, covariance, surface, match.share)
