"""How a robot finds its pose: an estimator between scans and at scans, and closed loops."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Count, Key, Pose, Scalar, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.belief.certainty import CertaintyField
from jaxplore.belief.perception import Perception
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.motion import between, compose
from jaxplore.localisation.closing import LoopCloser
from jaxplore.localisation.estimator import PoseEstimator, PoseState
from jaxplore.localisation.localiser import Localiser, LocaliserState, is_nearly_full, thin_scans
from jaxplore.localisation.odometry_model import OdometryModel
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.base import Sensor, update_grid
from jaxplore.sensing.beams import Scan


def close_loops(
    closer: LoopCloser,
    localiser: Localiser,
    known: LocaliserState,
    perception: Perception,
    belief: Belief,
    prior: OccupancyGrid,
    start: Pose,
) -> tuple[LocaliserState, Belief]:
    """Close loops, on the host; return the state, and the belief with the map of moved scans.

    The belief is the same object if no scan has moved. `prior` is the map that the robot knew in
    advance, and `start` the pose at the start.
    """
    known = closer.find_loops(localiser, known, perception.sensors)
    settled = closer.optimise_poses(localiser, known, perception.sensors)
    if settled is None:
        return known, belief
    grid = _map_scans((localiser, perception), settled, prior, start)
    return settled, _remap(perception, belief, grid, settled.pose)


@eqx.filter_jit
def _map_scans(
    given: tuple[Localiser, Perception], known: LocaliserState, prior: OccupancyGrid, start: Pose
) -> OccupancyGrid:
    """Return the map of all stored scans at their poses."""
    _, perception = given
    scans = known.scans

    def add(index: Count, grid: OccupancyGrid) -> OccupancyGrid:
        pose = scans.poses[index]
        stored = scans.scan(index, perception.sensors)
        for sensor, scan in zip(perception.sensors, stored, strict=True):
            sighting = sensor.sight(grid, scan, pose, perception.ground)
            grid = update_grid(grid, sighting, perception.sensor_model)
        return grid

    grid: OccupancyGrid = jax.lax.fori_loop(
        0, scans.number, add, perception.free_below_robot(prior, start)
    )
    return grid


@eqx.filter_jit
def _remap(perception: Perception, belief: Belief, grid: OccupancyGrid, pose: Pose) -> Belief:
    return perception.remap(belief, grid, pose)


class PoseKnowledge(NamedTuple):
    """What a robot knows of its pose; `known` is the state of its estimator.

    `spreads` (K,) are how exactly the robot knows its position as seen from old places nearby [m],
    see `LoopCloser.spreads`; None if it does not go back to them.
    """

    known: PoseState
    spreads: Float[Array, " K"] | None


class Motions(NamedTuple):
    """Motions of which a robot has made one: an odometry that jumps starts anew elsewhere, or it
    was frozen and tells a true motion.

    `motions` (N, 3) are (dx, dy, dyaw) by the odometry, in the frame of the robot. The first
    `number` of them are in use. `elapsed` is the time that they took [s].
    """

    motions: Float[Array, "N 3"]
    number: Count
    elapsed: Scalar


class Localisation(eqx.Module):
    """How a robot of an exploration scenario finds its pose.

    The robot starts at a known pose, or with a `ParticleLocaliser` anywhere on a known map, and
    then knows only its odometry and its scans. The true pose moves it and is for the judge:
    coverage is that of the map that its scans give at their true poses.

    Args:
        odometry: the true odometry; its errors are what the localiser expects when absent.
        localiser: estimates the pose: a `Localiser` by default, which matches scans while it maps,
            or on a known map a `ParticleLocaliser`. While its pose is not known, the robot observes
            none: it brakes, and maps nothing.
        closer: closes loops of a `Localiser`; none when absent.
        closing_rate: rate at which loops are looked for [Hz].
        most_uncertainty: standard deviation of the position as seen from an old place nearby,
            beyond which that place is worth a visit, to close a loop [m]; None for never. At twice
            the bound it is worth as much as the place with the most information. For a `Localiser`.
        certainty: how well scans tell the position, for controllers that plan with it; None for
            others.

    Raises:
        ValueError: a part of another class, a rate that is not positive; a closer or a greatest
            uncertainty beside a localiser that makes no map.
    """

    odometry: OdometryModel
    localiser: PoseEstimator
    closer: LoopCloser | None
    most_uncertainty: Scalar | None
    certainty: CertaintyField | None
    closing_rate: float = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        odometry: OdometryModel | None = None,
        localiser: PoseEstimator | None = None,
        closer: LoopCloser | None = None,
        *,
        closing_rate: float = 1.0,
        most_uncertainty: ArrayLike | None = None,
        certainty: CertaintyField | None = None,
    ) -> None:
        if localiser is None:
            localiser = Localiser(odometry)
        self.localiser = localiser
        self.odometry = localiser.expected_odometry if odometry is None else odometry
        self.closer = closer
        self.closing_rate = _checks.number("closing_rate", closing_rate, above=0.0)
        self.most_uncertainty, self.certainty = None, certainty
        for name, given in (("closer", closer), ("most_uncertainty", most_uncertainty)):
            if given is not None and not isinstance(localiser, Localiser):
                raise ValueError(
                    f"{name} is given beside a {type(localiser).__name__}, which closes no loops; "
                    "accepted: None"
                )
        if most_uncertainty is not None:
            self.most_uncertainty = _checks.scalar("most_uncertainty", most_uncertainty, above=0.0)

    def init(
        self, pose: Pose, grid: OccupancyGrid, sensors: Sequence[Sensor], key: Key | None
    ) -> PoseKnowledge:
        """Return what the robot knows at the start.

        Args:
            pose: pose (x, y, yaw) at the start [m, m, rad].
            grid: map of the belief at the start.
            sensors: the sensors.
            key: random key of the estimator; nothing depends on the run when absent.
        """
        known = self.localiser.start(pose, grid, sensors, key)
        spreads = None if self.most_uncertainty is None else jnp.zeros(known.scans.capacity)
        return PoseKnowledge(known, spreads)

    def observe_state(
        self, place: PoseKnowledge, errors: Any, robot: Dynamics, state: StateVector
    ) -> StateVector:
        """Return the state (nx,) that the robot takes to be its own; the pose is NaN while it does
        not know it.

        Args:
            place: what the robot knows of its pose.
            errors: errors of the odometry in this run.
            robot: model of the robot.
            state: true state (nx,). What is neither pose nor velocity is measured as it is.
        """
        known = place.known
        pose = jnp.where(known.is_known, known.pose, jnp.nan)
        error = self.odometry.velocity_error(errors, known.errors)
        return robot.with_pose(state, pose, error)

    def predict(self, place: PoseKnowledge, motion: Pose, period: Scalar) -> PoseKnowledge:
        """Return what the robot knows after a motion.

        Args:
            place: what it knew before.
            motion: motion (dx, dy, dyaw) by the odometry, in the frame of the robot [m, m, rad].
            period: time that it took [s].
        """
        return place._replace(known=self.localiser.predict(place.known, motion, period))

    def follow(
        self,
        place: PoseKnowledge,
        motions: Motions,
        scans: Sequence[Scan],
        sensors: Sequence[Sensor],
    ) -> tuple[PoseKnowledge, PoseKnowledge]:
        """Return what the robot knows after one of several motions, before scans correct it and
        after that: the motion after which more of the first scan lies on known surfaces.

        Args:
            place: what it knew before.
            motions: the motions.
            scans: a scan of each sensor.
            sensors: the sensors.
        """

        def try_motion(
            index: Count, best: tuple[Count, PoseKnowledge]
        ) -> tuple[Count, PoseKnowledge]:
            after = self.predict(place, motions.motions[index], motions.elapsed)
            found = self.correct(after, scans, sensors)
            shares = (each.known.share for each in (found, best[1]))
            is_better = (index == 0) | jnp.greater(*shares)
            select = functools.partial(jnp.where, is_better)
            chosen: tuple[Count, PoseKnowledge] = jax.tree.map(select, (index, found), best)
            return chosen

        # A loop, in which the matching of scans is compiled once.
        first = (jnp.zeros((), jnp.int32), place)
        best, found = jax.lax.fori_loop(0, motions.number, try_motion, first)
        return self.predict(place, motions.motions[best], motions.elapsed), found

    def correct(
        self, place: PoseKnowledge, scans: Sequence[Scan], sensors: Sequence[Sensor]
    ) -> PoseKnowledge:
        """Return what the robot knows after scans.

        Args:
            place: what it knew before.
            scans: a scan of each sensor.
            sensors: the sensors.
        """
        return place._replace(known=self.localiser.correct(place.known, scans, sensors))

    def replace_closer(self, closer: LoopCloser) -> "Localisation":
        """Return the same localisation with another closer."""
        other: Localisation = eqx.tree_at(lambda each: each.closer, self, closer)
        return other

    def inform(self, place: PoseKnowledge, belief: Belief) -> Belief:
        """Return the belief with what planning needs of the localisation, for the next fields.

        Args:
            place: what the robot knows of its pose.
            belief: the belief.
        """
        known = place.known
        if self.certainty is not None:
            belief = dataclasses.replace(
                belief,
                certainty=self.certainty(belief.grid, belief.clearance, known.pose[:2]),
                position_variance=known.uncertainty**2,
            )
        if self.most_uncertainty is not None and place.spreads is not None:
            share = jnp.clip(place.spreads / self.most_uncertainty - 1.0, 0.0, 1.0)
            worth = places_to_revisit(_localiser_state(place), belief, share)
            belief = dataclasses.replace(belief, revisit=worth)
        return belief

    def close_loops(
        self,
        place: PoseKnowledge,
        belief: Belief,
        perception: Perception,
        prior: OccupancyGrid,
        start: Pose,
    ) -> tuple[PoseKnowledge, Belief]:
        """Close loops, on the host; return what the robot knows of its pose, and the belief.

        Where there is hardly room for more scans, every second one is left out first.

        Args:
            place: what it knew before.
            belief: the belief before.
            perception: makes its fields anew where the map has moved.
            prior: map that the robot knew in advance.
            start: pose at the start.
        """
        localiser = self.localiser
        if self.closer is None or not isinstance(localiser, Localiser):
            return place, belief
        known = _localiser_state(place)
        if is_nearly_full(known):
            known = thin_scans(known)
        known, belief = close_loops(self.closer, localiser, known, perception, belief, prior, start)
        if place.spreads is None:
            return place._replace(known=known), belief
        return PoseKnowledge(known, self.closer.spreads(localiser, known)), belief


def places_to_revisit(
    known: LocaliserState, belief: Belief, share: Float[Array, " K"]
) -> Float[Array, "rows columns"]:
    """Return the worth of the nodes at stored scans [nat].

    It is the share (K,) of the scan stored there, times the greatest information of any node.
    """
    frame, total = belief.information.frame, belief.information.total
    rows, columns = total.shape
    row, column = jnp.unstack(jax.vmap(frame.to_cell)(known.scans.poses[:, :2]), axis=1)
    is_inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    at = jnp.where(is_inside, row * columns + column, rows * columns)
    worth = jnp.zeros(rows * columns).at[at].max(share * total.max(), mode="drop")
    return worth.reshape(rows, columns)


def correct_state(robot: Dynamics, state: StateVector, before: Pose, after: Pose) -> StateVector:
    """Return a state (nx,) moved by the correction of the robot's pose from `before` to `after`."""
    return robot.with_pose(state, compose(after, between(before, robot.pose(state))))


def _localiser_state(place: PoseKnowledge) -> LocaliserState:
    """Return what a `Localiser` knows."""
    assert isinstance(place.known, LocaliserState)
    return place.known
