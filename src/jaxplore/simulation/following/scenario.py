"""The path-following scenario: a robot on a path among obstacles."""

import functools
import math
import operator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._describe import describe_fields
from jaxplore._limits import MOST_LAPS
from jaxplore._trees import HostOnly
from jaxplore._types import (
    ArrayLike,
    ControlVector,
    Flag,
    Key,
    Position,
    Scalar,
    StateVector,
    Vector,
)
from jaxplore._xla import on_device
from jaxplore.belief.belief import Belief
from jaxplore.belief.obstacles import Obstacles
from jaxplore.control.base import Controller, Info
from jaxplore.costs.comfort import acceleration
from jaxplore.costs.moving import MovingObstacleCost
from jaxplore.costs.path_following import ContouringCost, CorridorCost, LagCost
from jaxplore.dynamics.augmented import Augmented
from jaxplore.dynamics.base import ContinuousDynamics, State
from jaxplore.dynamics.goal_check import GOAL_RADIUS, GOAL_SPEED, GoalCheck, Motion
from jaxplore.geometry.outlines import Outlines
from jaxplore.geometry.path import Path
from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.report.following.data import PathFrame, PathRecord
from jaxplore.report.following.metrics import PathMetrics
from jaxplore.report.following.recording import PathRecording
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.following.agent_view import PathView
from jaxplore.simulation.following.state import PathState
from jaxplore.simulation.following.traffic import Traffic
from jaxplore.simulation.robot_fields import robot_fields
from jaxplore.simulation.scenario import Inspect, Scenario
from jaxplore.simulation.state import Moment

SAME = 1e-3
"""Difference of two distances from the path that is only rounding [m]."""
PREDICTIONS = ("constant-turn", "constant-velocity")
"""Motion models by which the robot may predict obstacles."""


class PathScenario(Scenario):
    """Path following of a robot among obstacles.

    It is finished when the robot itself, not the path parameter phi of its plan, is at rest at the
    end of an open path (`GoalCheck`), or has completed the laps of a closed one. A cusp of an open
    path is a stop as well: the path goes on for the robot when it is at rest there.

    Contacts with obstacles and corridor violations are counted and do not stop the robot.

    Args:
        robot: true model of the robot with its path parameter, as `mpcc` returns it.
        path: path to follow.
        start: start pose (x, y, yaw) [m, m, rad]; the start of the path, along it, when absent.
        laps: number of laps of a closed path.
        traffic: moving obstacles; none when absent.
        standing: static obstacles, known in advance; none when absent.
        control_rate: rate of the controls [Hz].
        goal_radius: distance from the end of an open path, and from a cusp, within which a robot at
            rest has reached it [m].
        goal_speed: speed up to which the robot is at rest there [m/s].
        tracking_noise: standard deviations of the obstacles' positions [m] and velocities [m/s] as
            the robot measures them.
        prediction: motion model by which the robot predicts obstacles, "constant-turn" or
            "constant-velocity"; static.
        growth: standard deviation of the obstacles' velocity in the prediction [m/s].
        turn_growth: standard deviation of the obstacles' turn rate in the prediction [rad/s].
        datum: point of a map's coordinates to which all positions here are relative; frames and
            recordings are in the map's coordinates.

    Raises:
        ValueError: a robot without a path parameter, a start that is no pose, laps or rates that
            are not positive, more than one lap of an open path, a negative deviation, another
            prediction.
    """

    frame_type = PathFrame
    metrics_type = PathMetrics

    robot: Augmented
    path: Path
    start: StateVector
    end: Scalar
    stops: Float[Array, " S"]
    goal_radius: Scalar
    goal_speed: Scalar
    traffic: Traffic | None
    standing: Outlines | None
    control_period: Scalar
    tracking_noise: Float[Array, "2"]
    growth: Scalar
    turn_growth: Scalar
    prediction: str = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        robot: Augmented,
        path: Path,
        *,
        start: Vector | None = None,
        laps: int = 1,
        traffic: Traffic | None = None,
        standing: Outlines | None = None,
        control_rate: float = 50.0,
        goal_radius: ArrayLike = GOAL_RADIUS,
        goal_speed: ArrayLike = GOAL_SPEED,
        tracking_noise: Vector = (0.02, 0.05),
        prediction: str = "constant-turn",
        growth: ArrayLike = 0.1,
        turn_growth: ArrayLike = 0.1,
        datum: Datum = ORIGIN,
    ) -> None:
        self.placed = HostOnly(datum)
        if "phi" not in robot.state_names:
            raise ValueError(
                f"robot has the states {', '.join(robot.state_names)}; accepted: one with phi, "
                "such as mpcc returns"
            )
        rounds = _checks.positive_int("laps", laps, at_most=MOST_LAPS)
        if rounds > 1 and not path.is_closed:
            raise ValueError(f"laps is {laps!r} of an open path; accepted: 1")
        self.robot, self.path = robot, path
        self.traffic = None if traffic is None or traffic.number == 0 else traffic
        self.standing = None if standing is None or standing.number == 0 else standing
        self.goal_radius = _checks.scalar("goal_radius", goal_radius, above=0.0)
        self.goal_speed = _checks.scalar("goal_speed", goal_speed, above=0.0)
        self.end = rounds * path.length
        ends = path.length[None]
        self.stops = ends[:0] if path.is_closed else jnp.concatenate([path.stops, ends])
        if start is None:
            point = path.at(jnp.zeros(()))
            pose = [float(value) for value in (point.x, point.y, point.heading)]
        else:
            pose = np.asarray(_checks.vector("start", start, 3), np.float64).tolist()
            unit = "a yaw is in radians, not in degrees"
            _checks.warn_above("yaw of start", pose[2], math.tau, unit)
            _checks.near("start", pose[:2], _checks.PATH_STEP)
        state = robot.at_pose(*pose)
        phi = _start_of(path, robot.position(state))
        self.start = robot.with_component(state, "phi", phi)
        rate = _checks.number("control_rate", control_rate, above=0.0)
        self.control_period = on_device(np.asarray(1.0 / rate, np.float32))
        self.tracking_noise = _checks.vector("tracking_noise", tracking_noise, 2, at_least=0.0)
        if prediction not in PREDICTIONS:
            raise ValueError(f"prediction is {prediction!r}; accepted: {', '.join(PREDICTIONS)}")
        self.prediction = prediction
        self.growth = _checks.scalar("growth", growth, at_least=0.0)
        self.turn_growth = _checks.scalar("turn_growth", turn_growth, at_least=0.0)

    def __repr__(self) -> str:
        return describe_fields(self, "path", "robot", "start", "end", "traffic", "period")

    @property
    def objective(self) -> str:
        """Default objective: time to the end, plus violations of the corridor and contacts."""
        return "finished_at + 10*corridor_violations + 10*collisions"

    def true_obstacles(self, time: Scalar) -> Obstacles | None:
        """Return the true obstacles, moving and static, at a time since the start [s]; None without
        any."""
        parts = [] if self.traffic is None else [self.traffic.at(time)]
        if self.standing is not None:
            parts.append(Obstacles(self.standing))
        return functools.reduce(operator.add, parts) if parts else None

    def obstacles(self, time: Scalar, *, key: Key) -> Obstacles | None:
        """Return the tracked obstacles at a time since the start [s]; None without any."""
        known = [] if self.traffic is None else [self._track(self.traffic.at(time), key)]
        if self.standing is not None:
            known.append(Obstacles(self.standing))
        return functools.reduce(operator.add, known) if known else None

    def _add_age(self, known: Obstacles | None) -> Obstacles | None:
        """Add an age to the obstacles if the tracker may fail: measurements can grow old then."""
        if not self.disturbances.is_blinding or known is None:
            return known
        return known.advance(jnp.zeros(()))

    def _track(self, truth: Obstacles, key: Key) -> Obstacles:
        """Measure the obstacles with noise, and set the uncertainty of their prediction."""
        keys, size = jax.random.split(key), truth.velocities.shape
        position_std, velocity_std = self.tracking_noise
        off = position_std * jax.random.normal(keys[0], size)
        faster = velocity_std * jax.random.normal(keys[1], size)
        is_turning = self.prediction == "constant-turn"
        # A tracker measures positions and velocities, so its noise moves an outline as a whole.
        moved = eqx.tree_at(
            lambda known: known.corners, truth.outlines, truth.outlines.corners + off[:, None]
        )
        return Obstacles(
            moved,
            truth.velocities + faster,
            truth.turn_rates if is_turning else 0.0,
            centres=truth.centres + off,
            std=position_std,
            growth=self.growth,
            turn_growth=self.turn_growth if is_turning else 0.0,
        )

    def init(self, key: Key | None) -> tuple[PathState, Belief | None]:
        """Return the initial state, and the belief with the true obstacles. Nothing is random."""
        phi, start = self.robot.component(self.start, "phi"), jnp.zeros(())
        truth = self._add_age(self.true_obstacles(start))
        state = PathState(self.start, phi, jnp.sum(self.stops < phi, dtype=jnp.int32), truth)
        return state, self._belief(state)

    def perceive(
        self, state: PathState, moment: Moment, key: Key
    ) -> tuple[PathState, Belief | None]:
        """Measure the obstacles, or predict them from their last measurement during a dropout."""
        known = self._add_age(self.obstacles(moment.time, key=key))
        if self.disturbances.is_blinding and known is not None and state.known is not None:
            # By `_add_age` all obstacles have an age, so both have the same leaves to choose from.
            predicted = state.known.advance(self.control_period)
            known = jax.tree.map(functools.partial(jnp.where, moment.is_blind), predicted, known)
        state = state._replace(known=known)
        return state, self._belief(state)

    def _belief(self, state: PathState) -> Belief | None:
        """Return what the controller knows; None without obstacles and cusps."""
        has_cusps = self.stops.shape[0] > 1
        if state.known is None and not has_cusps:
            return None
        stop = self._stretch(state)[1] if has_cusps else None
        return Belief(obstacles=state.known, path_stop=stop)

    def _stretch(self, state: PathState) -> tuple[Scalar, Scalar]:
        """Return the arc lengths of the last and of the next stop of an open path [m]."""
        stops = jnp.concatenate([jnp.zeros(1), self.stops])
        last = jnp.minimum(state.next_stop, self.stops.shape[0] - 1)
        return stops[last], stops[last + 1]

    def advance(
        self, state: PathState, control: ControlVector, moment: Moment, info: Info
    ) -> tuple[PathState, PathRecord]:
        """Move the robot, and record the errors by the controller's own cost terms."""
        model, path, period = self.robot, self.path, self.control_period
        moved = model.step(state.robot, control, period)
        # A control that is not finite does not move the robot.
        robot = jnp.where(jnp.all(jnp.isfinite(moved)), moved, state.robot)
        stretch, is_stop = None, jnp.array(False)
        if not path.is_closed:
            # Nobody passes a stop before the robot has stood there.
            stretch = self._stretch(state)
            phi = jnp.minimum(model.component(robot, "phi"), stretch[1])
            robot = model.with_component(robot, "phi", phi)
            stop = path.at(stretch[1]).position
            check = GoalCheck(stop, self.goal_radius, speed=self.goal_speed)
            motion = Motion.between(model, state.robot, robot, period)
            is_stop = check.is_reached(model.pose(robot), motion)
        here = State(robot, model, control)
        progress = path.nearest(here.position, near=state.progress, within=stretch)
        room = gap = jnp.full((), jnp.inf)
        if path.has_room:
            # By the true position, not by the phi of the plan.
            room = CorridorCost(path, parameter=lambda _: progress).clearance(here)
        # The obstacles move during the step as well, so the gap is that at its end.
        truth = self.true_obstacles(moment.time + period)
        if truth is not None:
            gap = MovingObstacleCost(nearness=None).room(here, truth)
        felt = jnp.full(2, jnp.nan)
        if isinstance(model.physical, ContinuousDynamics):
            felt = jnp.stack(acceleration(robot, control, model))
        record = PathRecord(
            state=robot,
            control=control,
            contouring=ContouringCost(path).error(here),
            lag=LagCost(path).error(here),
            progress=progress,
            deviation=path.errors(here.position, progress).contouring,
            room=room,
            gap=gap,
            acceleration=felt,
            effective_sample_size=info.effective_sample_size,
            is_finite=info.is_finite,
            is_faulty=moment.is_faulty,
        )
        made = state.next_stop + is_stop.astype(jnp.int32)
        return state._replace(robot=robot, progress=progress, next_stop=made), record

    def is_unfinished(self, state: PathState) -> Flag:
        """Check whether the robot has not reached the end yet."""
        if self.path.is_closed:
            return state.progress < self.end
        return state.next_stop < self.stops.shape[0]

    def progress(self, state: PathState) -> tuple[float, str]:
        """Return the share of the path that is done, and the distance as text."""
        done, end = float(state.progress), float(self.end)
        return done / end, f"{done:6.1f} of {end:.1f} m"

    def frame(
        self, state: PathState, moment: Moment, inspect: Inspect | None, key: Key
    ) -> dict[str, Any]:
        """Return the obstacles and the plan before a step; see `PathFrame`."""
        truth = self.true_obstacles(moment.time)
        arrays = {
            "position": self.robot.position(state.robot),
            "heading": self.robot.heading(state.robot),
            "corners": jnp.zeros((0, 1, 2)) if truth is None else truth.outlines.corners,
            "samples": jnp.zeros((0, 1, 2)),
            "weights": jnp.zeros(0),
            "plan": jnp.zeros((0, 2)),
            "sample_terms": {},
        }
        if inspect is None:
            return arrays
        # The key is that of the coming step, so the plan uses the measurements of that step.
        _, belief = self.perceive(state, moment, key)
        plan, position = inspect(moment.observed, belief), jax.vmap(self.robot.position)
        return arrays | {
            "samples": jax.vmap(position)(plan.samples),
            "weights": plan.weights,
            "plan": position(plan.nominal.states),
            "sample_terms": dict(plan.sample_terms),
        }

    def agent_view(self, view_cells: int | None) -> PathView:
        """Return path following as an agent sees it. There is no map, so a view is rejected.

        Raises:
            ValueError: a view is given.
        """
        if view_cells is not None:
            raise ValueError("view is given beside a path; accepted: without a map there is none")
        # The number of obstacles is a shape of the observation, and the same at all times.
        truth = self.true_obstacles(jnp.zeros(()))
        number = 0 if truth is None else truth.outlines.number
        return PathView(self, view_cells, path=self.path, num_obstacles=number)

    def recording(
        self,
        controller: Controller | None,
        before: PathState,
        run: ChunkedRun[Any, PathRecord, PathFrame],
    ) -> PathRecording:
        """Make the recording of a run."""
        path, model, truth = self.path, self.robot, self.true_obstacles(jnp.zeros(()))
        after: PathState = run.state.task
        end = float(self.end)
        if not path.is_closed and not bool(self.is_unfinished(after)):
            end = float(after.progress)  # it stands within the radius of the end
        centre, edges = _centre_and_edges(path)
        local = PathRecording(
            **run.common(self.period),
            **robot_fields(model, self.start),
            start_progress=float(before.progress),
            centre=centre,
            edges=edges,
            length=float(path.length),
            end=end,
            is_closed=path.is_closed,
            obstacle_radii=np.zeros(0) if truth is None else np.asarray(truth.outlines.radii),
        )
        return local.move(self.datum.offset)


@eqx.filter_jit
def _start_of(path: Path, position: Position) -> Scalar:
    """Return the arc length of the point of a path that is nearest to a start position [m].

    On a closed path a start up to a quarter of the length behind the line has a negative one.
    """
    anywhere = path.nearest(position)
    if not path.is_closed:
        return anywhere
    # A robot just behind the line is about to begin its lap, not to end it. Where the path crosses
    # itself, two points are equally near up to rounding: the one near the line is taken.
    at_line = path.nearest(position, near=jnp.zeros(()))
    distances = [jnp.linalg.norm(path.at(each).position - position) for each in (at_line, anywhere)]
    return jnp.where(distances[0] <= distances[1] + SAME, at_line, anywhere)


def _centre_and_edges(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return points (P, 2) of the path, and of the corridor's edges (2, P, 2) if it has one."""
    centre, tangents = np.asarray(path.points), np.asarray(path.tangents)
    if not path.has_room:
        return centre, np.zeros((0, *centre.shape))
    normals = np.stack([-tangents[:, 1], tangents[:, 0]], axis=-1)
    left, right = np.asarray(path.half_widths).T[..., None]
    return centre, np.stack([centre + left * normals, centre - right * normals])
