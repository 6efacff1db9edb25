"""A robot that does not know its pose: odometry with errors, localisation, and what judges it."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Count, GridMask, GridValues, Key, Pose, Scalar, StateVector
from jaxplore.belief import scan_map
from jaxplore.belief.belief import Belief
from jaxplore.belief.certainty import CertaintyField
from jaxplore.belief.perception import Perception
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.motion import between, compose
from jaxplore.localisation.closing import LoopCloser
from jaxplore.localisation.estimator import PoseEstimator, PoseState
from jaxplore.localisation.localiser import Localiser, LocaliserState
from jaxplore.localisation.odometry_model import OdometryModel
from jaxplore.localisation.thinning import is_nearly_full, thinned
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.exploration.data import LocalisationData
from jaxplore.sensing.base import Sensor, update_grid
from jaxplore.sensing.beams import Scan
from jaxplore.simulation.exploration.progress import MapSums

_ODOMETRY = 2**31 + 4
"""What is folded into the key of a run for its odometry; no step has such a number."""


class Located(NamedTuple):
    """State of the localisation, and what only the judge knows.

    Args:
        known: what the robot knows.
        errors: errors of the odometry in this run.
        key: random key of its noise.
        true_poses: (K, 3) true poses of the stored scans.
        reckoned: pose by the odometry alone.
        reckoned_poses: (K, 3) poses of the stored scans by the odometry alone.
        reference: (H, W) map that the same scans give at the true poses.
        spreads: (K,) how exactly the robot knows its position as seen from old places nearby [m],
            see `LoopCloser.spreads`; None if it does not go back to them.
    """

    known: PoseState
    errors: Any
    key: Key
    true_poses: Float[Array, "K 3"]
    reckoned: Pose
    reckoned_poses: Float[Array, "K 3"]
    reference: GridValues
    spreads: Float[Array, " K"] | None

    def recorded(self, pose: Pose) -> dict[str, Scalar]:
        """Return the fields of a record.

        Args:
            pose: true pose of the robot [m, m, rad].
        """
        away = self.known.pose - pose
        return {
            "pose_error": jnp.hypot(away[0], away[1]),
            "uncertainty": self.known.uncertainty,
        }


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
        _kinds.instance("odometry", odometry, OdometryModel, may_be_none=True)
        _kinds.instance("localiser", localiser, PoseEstimator, may_be_none=True)
        _kinds.instance("closer", closer, LoopCloser, may_be_none=True)
        if localiser is None:
            localiser = Localiser(odometry)
        self.localiser = localiser
        self.odometry = localiser.expected_odometry if odometry is None else odometry
        self.closer = closer
        self.closing_rate = _checks.number("closing_rate", closing_rate, above=0.0)
        _kinds.instance("certainty", certainty, CertaintyField, may_be_none=True)
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
    ) -> Located:
        """Return the state at the start.

        Args:
            pose: pose (x, y, yaw) at the start [m, m, rad].
            grid: map of the belief at the start.
            sensors: the sensors.
            key: random key of the run; the odometry has no constant errors when absent.
        """
        drawn = None if key is None else jax.random.fold_in(key, _ODOMETRY)
        own = None if drawn is None else jax.random.fold_in(drawn, 2)
        known = self.localiser.start(pose, grid, sensors, own)
        return Located(
            known,
            self.odometry.draw(drawn),
            jax.random.key(0) if drawn is None else jax.random.fold_in(drawn, 1),
            known.scans.poses,
            pose,
            known.scans.poses,
            grid.probability,
            None if self.most_uncertainty is None else jnp.zeros(known.scans.capacity),
        )

    def observed(self, located: Located, robot: Dynamics, state: StateVector) -> StateVector:
        """Return the state (nx,) that the robot takes to be its own; the pose is NaN while it does
        not know it.

        Args:
            located: state of the localisation.
            robot: model of the robot.
            state: true state (nx,). What is neither pose nor velocity is measured as it is.
        """
        known = located.known
        pose = jnp.where(known.is_known, known.pose, jnp.nan)
        error = self.odometry.velocity_error(located.errors, known.errors)
        return robot.with_pose(state, pose, error)

    def moved(
        self, located: Located, before: Pose, after: Pose, step: Count, period: Scalar
    ) -> Located:
        """Return the state after a control period, in which only the odometry is measured.

        Args:
            located: state before it.
            before: true pose before it.
            after: true pose after it.
            step: number of steps before it.
            period: control period [s].
        """
        key = jax.random.fold_in(located.key, step)
        true = between(before, after)
        motion, errors = self.odometry.measure(true, period, located.errors, key)
        return located._replace(
            errors=errors,
            known=self.localiser.predicted(located.known, motion, period),
            reckoned=compose(located.reckoned, motion),
        )

    def scanned(
        self, located: Located, scans: Sequence[Scan], sensors: Sequence[Sensor], pose: Pose
    ) -> Located:
        """Return the state after scans.

        Args:
            located: state before them.
            scans: a scan of each sensor.
            sensors: the sensors.
            pose: true pose of the robot.
        """
        known = self.localiser.corrected(located.known, scans, sensors)
        is_new = known.scans.number > located.known.scans.number
        at = jnp.where(is_new, known.scans.last, known.scans.capacity)
        return located._replace(
            known=known,
            true_poses=located.true_poses.at[at].set(pose, mode="drop"),
            reckoned_poses=located.reckoned_poses.at[at].set(located.reckoned, mode="drop"),
        )

    def judged(
        self,
        located: Located,
        sums: MapSums,
        perception: Perception,
        scans: Sequence[Scan],
        pose: Pose,
        reachable: GridMask,
        grid: OccupancyGrid,
    ) -> tuple[Located, MapSums]:
        """Return the state with the scans in the reference map, and the sums over that map.

        Args:
            located: state before.
            sums: sums over the reference map.
            perception: updates the belief.
            scans: a scan of each sensor.
            pose: true pose of the robot.
            reachable: (H, W) cells that count for the progress.
            grid: the belief's map, whose frame is used.
        """
        reference = grid.with_probability(located.reference)
        window = perception.window(reference, pose)
        counted = window.read(reachable)
        before = MapSums.of(window.read(reference.probability), counted)
        for sensor, scan in zip(perception.sensors, scans, strict=True):
            sighting = sensor.sight(reference, scan, pose, perception.ground)
            reference = update_grid(reference, sighting, perception.sensor_model)
        after = MapSums.of(window.read(reference.probability), counted)
        changed = located._replace(reference=reference.probability)
        return changed, sums.changed(before, after)

    def informed(self, located: Located, belief: Belief) -> Belief:
        """Return the belief with what planning needs of the localisation, for the next fields.

        Args:
            located: state of the localisation.
            belief: the belief.
        """
        known = located.known
        if self.certainty is not None:
            belief = dataclasses.replace(
                belief,
                certainty=self.certainty(belief.grid, belief.clearance, known.pose[:2]),
                position_variance=known.uncertainty**2,
            )
        if self.most_uncertainty is not None and located.spreads is not None:
            share = jnp.clip(located.spreads / self.most_uncertainty - 1.0, 0.0, 1.0)
            worth = places_to_revisit(_mapped(located), belief, share)
            belief = dataclasses.replace(belief, revisit=worth)
        return belief

    def revised(
        self,
        located: Located,
        belief: Belief,
        perception: Perception,
        prior: OccupancyGrid,
        start: Pose,
    ) -> tuple[Located, Belief]:
        """Close loops, on the host; return the state and the belief.

        Args:
            located: state before.
            belief: the belief before.
            perception: makes its fields anew where the map has moved.
            prior: map that the robot knew in advance.
            start: pose at the start.
        """
        localiser = self.localiser
        if self.closer is None or not isinstance(localiser, Localiser):
            return located, belief
        if is_nearly_full(_mapped(located)):
            located = _thinned(located)
        known, belief = scan_map.revised(
            self.closer, localiser, _mapped(located), perception, belief, prior, start
        )
        located = located._replace(known=known)
        if located.spreads is not None:
            located = located._replace(spreads=self.closer.spreads(localiser, known))
        return located, belief

    def data(self, located: Located, grid: OccupancyGrid) -> LocalisationData:
        """Return what the report shows of the localisation.

        Args:
            located: state at the end.
            grid: map of the belief, with its frame.
        """
        known, scans = located.known, located.known.scans
        number = int(scans.number)
        return LocalisationData(
            true_poses=np.asarray(located.true_poses, np.float64)[:number],
            poses=np.asarray(scans.poses, np.float64)[:number],
            reckoned=np.asarray(located.reckoned_poses, np.float64)[:number],
            way=np.asarray(scans.way, np.float64)[:number],
            reference=grid.cropped(located.reference),
            num_loops=int(known.closures.number) if isinstance(known, LocaliserState) else None,
        )


def places_to_revisit(
    known: LocaliserState, belief: Belief, share: Float[Array, " K"]
) -> Float[Array, "rows columns"]:
    """Return the worth of nodes at stored scans [nat]: a share of the greatest information of all.

    Args:
        known: what the robot knows of its way.
        belief: its belief.
        share: (K,) share of each stored scan.
    """
    frame, total = belief.information.frame, belief.information.total
    rows, columns = total.shape
    row, column = jnp.unstack(jax.vmap(frame.to_cell)(known.scans.poses[:, :2]), axis=1)
    is_inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    at = jnp.where(is_inside, row * columns + column, rows * columns)
    worth = jnp.zeros(rows * columns).at[at].max(share * total.max(), mode="drop")
    return worth.reshape(rows, columns)


def corrected_state(robot: Dynamics, state: StateVector, before: Pose, after: Pose) -> StateVector:
    """Return a state (nx,) moved by the correction of the robot's pose.

    Args:
        robot: model of the robot.
        state: the state.
        before: pose of the robot before the correction.
        after: its pose after it.
    """
    return robot.with_pose(state, compose(after, between(before, robot.pose(state))))


def _mapped(located: Located) -> LocaliserState:
    """Return what a `Localiser` knows."""
    assert isinstance(located.known, LocaliserState)
    return located.known


@eqx.filter_jit
def _thinned(located: Located) -> Located:
    """Return the state with every second stored scan left out."""

    def halved(rows: Float[Array, "K 3"]) -> Float[Array, "K 3"]:
        kept = rows[::2]
        return jnp.zeros_like(rows).at[: len(kept)].set(kept)

    return located._replace(
        known=thinned(_mapped(located)),
        true_poses=halved(located.true_poses),
        reckoned_poses=halved(located.reckoned_poses),
    )
