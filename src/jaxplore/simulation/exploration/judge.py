"""What is true of a robot's map and pose, for the record: the robot knows nothing of it."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore._types import Flag, GridMask, GridValues, Pose, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.belief.perception import Perception
from jaxplore.geometry.motion import compose
from jaxplore.localisation.localiser import LocaliserState, halve
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.exploration.data import LocalisationData, MapProgress
from jaxplore.robot.clock import when_due
from jaxplore.robot.localisation import PoseKnowledge
from jaxplore.robot.robot import Measurement, RobotState, Sight
from jaxplore.sensing.base import Sensor, update_grid
from jaxplore.sensing.beams import Scan
from jaxplore.simulation.exploration.part_truth import PartTruth, Vantage
from jaxplore.simulation.exploration.progress import MapSums, map_progress
from jaxplore.simulation.exploration.true_world import TrueWorld


class TrueTrack(NamedTuple):
    """Where a robot that does not know its pose was, and what its scans give there.

    `true_poses` (K, 3) are those of the stored scans, and `reckoned_poses` (K, 3) the same by the
    odometry alone. `reckoned` is the present pose by the odometry alone. `reference` (H, W) is the
    map that the same scans give at the true poses.
    """

    true_poses: Float[Array, "K 3"]
    reckoned: Pose
    reckoned_poses: Float[Array, "K 3"]
    reference: GridValues

    @classmethod
    def at_start(cls, pose: Pose, place: PoseKnowledge, grid: OccupancyGrid) -> "TrueTrack":
        """Return the track before the first scan, from the true pose at the start [m, m, rad]."""
        poses = place.known.scans.poses
        return cls(poses, pose, poses, grid.probability)

    def add_motion(self, motion: Pose) -> "TrueTrack":
        """Return the track after a motion by the odometry (dx, dy, dyaw) [m, m, rad]."""
        return self._replace(reckoned=compose(self.reckoned, motion))

    def add_scans(self, before: PoseKnowledge, after: PoseKnowledge, pose: Pose) -> "TrueTrack":
        """Return the track with the poses of a scan, true and reckoned, if the robot stored it.

        `pose` is its true pose. `before` and `after` are what the robot knew of its pose before and
        after the scans.
        """
        scans = after.known.scans
        at = jnp.where(scans.number > before.known.scans.number, scans.last, scans.capacity)
        return self._replace(
            true_poses=self.true_poses.at[at].set(pose, mode="drop"),
            reckoned_poses=self.reckoned_poses.at[at].set(self.reckoned, mode="drop"),
        )

    def data(self, place: PoseKnowledge, grid: OccupancyGrid) -> LocalisationData:
        """Return what the report shows of the localisation, from the knowledge at the end."""
        known, scans = place.known, place.known.scans
        number = int(scans.number)
        return LocalisationData(
            true_poses=np.asarray(self.true_poses, np.float64)[:number],
            poses=np.asarray(scans.poses, np.float64)[:number],
            reckoned=np.asarray(self.reckoned_poses, np.float64)[:number],
            way=np.asarray(scans.way, np.float64)[:number],
            reference=grid.crop(self.reference),
            num_loops=int(known.closures.number) if isinstance(known, LocaliserState) else None,
        )


@eqx.filter_jit
def thin(track: TrueTrack) -> TrueTrack:
    """Return a track with every second stored scan left out."""
    return track._replace(
        true_poses=halve(track.true_poses), reckoned_poses=halve(track.reckoned_poses)
    )


class Judged(NamedTuple):
    """What the record says of a robot's knowledge.

    `sums` and `progress` are those of its map, as of the last map update. If the robot does not
    know its pose, they are those of the map that its scans give at their true poses, and `track` is
    where it was; None otherwise.
    """

    sums: MapSums
    progress: MapProgress
    track: TrueTrack | None

    @classmethod
    def at_start(cls, belief: Belief, reachable: GridMask, track: TrueTrack | None) -> "Judged":
        """Return what is said before the first scan; `track` is None if the pose is known."""
        sums = MapSums.of(belief.grid.probability, reachable)
        return cls(sums, map_progress(sums, belief.grid), track)


class Judge(NamedTuple):
    """Counts what a robot has learned, beside its updates and never in them.

    A scan changes a window of the map. `count_before` adds the window up before the robot maps its
    scans, and `judge` after that. `reachable` (H, W) are the cells that count for the progress.
    `truths` are what is true of the robot's parts.
    """

    perception: Perception
    reachable: GridMask
    truths: tuple[PartTruth, ...]

    def count_window(self, grid: OccupancyGrid, pose: Pose) -> MapSums:
        """Add up the window of a map that scans from a pose [m, m, rad] may change."""
        window = self.perception.window(grid, pose)
        return MapSums.of(window.read(grid.probability), window.read(self.reachable))

    def count_before(
        self, own: RobotState, is_due: Flag, sight: Sight
    ) -> tuple[MapSums, RobotState]:
        """Add up the window that the scans of a robot will change, if they are taken.

        What the robot knows is returned as well, and depends on the sums: nothing reads the old map
        any more, so it is changed in place. XLA would copy it otherwise.
        """
        grid = own.belief.grid
        (before,) = when_due(
            is_due,
            sight.is_taken,
            lambda _: (self.count_window(grid, sight.pose),),
            (MapSums.none(),),
        )
        barrier = jax.lax.optimization_barrier
        probability, before = barrier((grid.probability, before))  # type: ignore[no-untyped-call]
        belief = dataclasses.replace(own.belief, grid=grid.with_probability(probability))
        return before, own._replace(belief=belief)

    def judge(
        self,
        judged: Judged,
        truths: dict[str, Any],
        before: MapSums,
        own: RobotState,
        measured: Measurement,
        sight: Sight,
        is_mapped: Flag,
        *,
        is_due: Flag,
        pose: Pose,
        place: PoseKnowledge | None,
        truth: TrueWorld,
        sensors: Sequence[Sensor],
    ) -> tuple[Judged, dict[str, Any]]:
        """Return what is said after the scans of a period, and the states of the truths of parts.

        `before` are the sums of the window before the scans. `own` is what the robot knows after
        them. `place` is what it knew of its pose before them; None if it knows its pose. `pose` is
        its true pose [m, m, rad]. `is_mapped` says whether the scans are in the map. `truth` is the
        true world.
        """

        assert measured.time is not None
        time = measured.time

        def add(former: Judged, states: dict[str, Any]) -> tuple[Judged, dict[str, Any]]:
            sums, _, track = former
            if place is None or own.place is None or track is None:
                sums = sums.update(before, self.count_window(own.belief.grid, sight.pose))
            else:
                track = track.add_scans(place, own.place, pose)
                reference, sums = self._refer(track, sums, own, measured.scans, pose, is_mapped)
                track = track._replace(reference=reference)
            progress = map_progress(sums, own.belief.grid)
            known = own.belief.parts
            vantage = Vantage(truth, sensors, pose, self.perception.parts, known)
            said = self.judge_parts(states, vantage, sums, time)
            return Judged(sums, progress, track), said

        return when_due(is_due, sight.is_taken, add, (judged, truths))

    def judge_parts(
        self, states: dict[str, Any], vantage: Vantage, sums: MapSums, time: Scalar
    ) -> dict[str, Any]:
        """Return the states of the truths of parts after scans; `sums` are those of the map."""
        number = sums.reachable.astype(jnp.float32)
        said = {
            each.name: each.judge(
                each.witness(states[each.name], vantage),
                vantage.known.get(each.name),
                *(self.reachable, number, time),
            )
            for each in self.truths
            if each.is_judging
        }
        return {**states, **said}

    def _refer(
        self,
        track: TrueTrack,
        sums: MapSums,
        own: RobotState,
        scans: Sequence[Scan],
        pose: Pose,
        is_mapped: Flag,
    ) -> tuple[GridValues, MapSums]:
        """Return the reference map with scans that the robot has mapped, and the sums over it."""
        perception = self.perception

        def add(values: GridValues, sums: MapSums) -> tuple[GridValues, MapSums]:
            reference = own.belief.grid.with_probability(values)
            before = self.count_window(reference, pose)
            for sensor, scan in zip(perception.sensors, scans, strict=True):
                sighting = sensor.sight(reference, scan, pose, perception.ground)
                reference = update_grid(reference, sighting, perception.sensor_model)
            return reference.probability, sums.update(before, self.count_window(reference, pose))

        found: tuple[GridValues, MapSums] = jax.lax.cond(
            is_mapped, add, lambda *same: same, track.reference, sums
        )
        return found
