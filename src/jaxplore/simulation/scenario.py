"""The protocol of a task, on which the loop, batches, studies, Gymnasium and reports rely."""

import abc
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxplore import _kinds
from jaxplore._describe import describe_fields
from jaxplore._trees import HostOnly, with_field
from jaxplore._types import ControlVector, Flag, Key, Scalar, StateVector
from jaxplore.control.base import Controller, Info, Members, SampledPlan
from jaxplore.control.guard import MotionGuard, ScanPoints
from jaxplore.dynamics.base import ContinuousDynamics, Dynamics
from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.report.compute import Timing
from jaxplore.report.metrics import Metrics
from jaxplore.report.recording import Frame, Recording, move_records
from jaxplore.robot.decision import Driver
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.disturbances import Disturbance, Disturbances, Place
from jaxplore.simulation.state import LoopState, Moment

type Inspect = Callable[[StateVector, Any], SampledPlan]
"""Function from an observed state and a belief to the sampled plan of the controller's step."""


class Scenario(eqx.Module):
    """A task in a world: measurements, dynamics, and the condition for the end.

    The closed loop (`jaxplore.simulation.loop`) is the same for all tasks. In each step it calls
    `perceive`, the controller, and `advance`. The state of a task is a NamedTuple, or any pytree,
    with the true state of the robot in `robot` (nx,).

    To add a kind of task, implement the abstract methods here, and the recording that `recording`
    returns. No other code needs a change. An environment shows it to an agent by `agent_view`.
    """

    robot: eqx.AbstractVar[Dynamics]
    """True model of the robot, the plant."""
    start: eqx.AbstractVar[StateVector]
    """State (nx,) of the robot at the start."""
    control_period: eqx.AbstractVar[Scalar]
    """Time between controls [s]."""
    disturbed_by: tuple[Disturbance, ...] = dataclasses.field(default=(), kw_only=True)
    """What makes the robot and the world differ from their model. See `with_disturbances`."""
    placed: HostOnly[Datum] = eqx.field(static=True, default=HostOnly(ORIGIN), kw_only=True)
    """Holder of `datum`."""
    guard: MotionGuard | None = dataclasses.field(default=None, kw_only=True)
    """Guard that stops the robot while its pose cannot be true, or None. See `with_guard`."""

    frame_type: ClassVar[type[Frame]] = Frame
    """Class of the frames; `frame` returns its fields."""
    metrics_type: ClassVar[type[Metrics]] = Metrics
    """Class of the metrics that its recordings compute."""

    def __repr__(self) -> str:
        return describe_fields(self, "robot", "start", "period")

    @property
    def period(self) -> float:
        """Time between controls [s], without the rounding of float32: 0.02, not
        0.019999999552965164."""
        return round(float(self.control_period), 7)

    @_kinds.check_arguments
    def with_disturbances[S: "Scenario"](self: S, disturbances: Sequence[Disturbance]) -> S:
        """Return the scenario with these disturbances, such as `Variation` and `Faults`.

        Args:
            disturbances: one of a name; measurements pass through them in this order.

        Raises:
            ValueError: something else, two of one name, or what cannot happen here.
        """
        _kinds.instances("disturbances", disturbances, Disturbance)
        for index, each in enumerate(disturbances):
            if each.name in (other.name for other in disturbances[:index]):
                raise ValueError(
                    f"disturbances[{index}] is a second {each.name!r}; accepted: one of a name"
                )
            each.check(self.place)
        return with_field(self, "disturbed_by", tuple(disturbances))

    @property
    def place(self) -> Place:
        """What disturbances are checked by. A task in a map or a volume replaces it."""
        return Place(self.robot, self.datum)

    @_kinds.check_arguments
    def with_guard[S: "Scenario"](self: S, guard: MotionGuard | None) -> S:
        """Return the scenario with a guard that stops the robot while its pose cannot be true.

        Args:
            guard: the guard; None for none.
        """
        return with_field(self, "guard", guard)

    @property
    def disturbances(self) -> Disturbances:
        """What the true robot differs by from its model, and what fails."""
        return Disturbances(self.disturbed_by)

    def driver(self, controller: Controller | None = None) -> Driver:
        """Return what decides the commands: the controller, and the guard that watches over it.

        Args:
            controller: the controller; None where the guard only judges.
        """
        return Driver(self.robot, controller, self.guard, self.control_period)

    def measure_state(self, state: Any) -> StateVector:
        """Return the state (nx,) that the robot's base measures: by default the true one.

        Args:
            state: the task's state.
        """
        robot: StateVector = state.robot
        return robot

    def scan_points(self, state: Any, moment: Moment | None = None) -> ScanPoints:
        """Return the newest scan for the guard, by which a stopped robot brakes; by default none.

        Args:
            state: the task's state, as `perceive` returned it.
            moment: time of the step before whose `perceive` the guard judges. If a scan comes in
                it, that is the time of the newest one.
        """
        return ScanPoints.blank(1)

    @property
    def datum(self) -> Datum:
        """Point of the map's coordinates to which all positions of the scenario are relative; its
        frames and recordings are in the map's. The origin by default. For the host only."""
        return self.placed.value

    def records_on_map(self, records: Any) -> Any:
        """Return records of steps in NumPy, with their states in the coordinates of the map."""
        return move_records(records, self.datum.offset, self.robot.state_names)

    @property
    def objective(self) -> str:
        """Default objective of tuning, to minimize: a sum of metrics, see `jaxplore.study`."""
        return "finished_at"

    @property
    def metric_groups(self) -> tuple[str, ...]:
        """Names of groups of metrics beside those of `metrics_type`; none by default."""
        return ()

    @abc.abstractmethod
    def init(self, key: Key | None) -> tuple[Any, Any]:
        """Return the initial state of the task, and the belief before any measurement.

        Args:
            key: random key of the run, for a random start; nothing is random when absent.
        """

    @abc.abstractmethod
    def perceive(self, state: Any, moment: Moment, key: Key) -> tuple[Any, Any]:
        """Simulate the measurements; return the task's state and the controller's belief.

        Args:
            state: the task's state.
            moment: time of the step, and the observed state.
            key: random key of this step's measurements.
        """

    @abc.abstractmethod
    def advance(
        self, state: Any, control: ControlVector, moment: Moment, info: Info
    ) -> tuple[Any, Any]:
        """Apply a control for one period; return the task's state and the record of the step.

        Args:
            state: the task's state, as `perceive` returned it.
            control: (nu,) control that takes effect.
            moment: the moment that was passed to `perceive`.
            info: diagnostics of the controller's step.
        """

    @abc.abstractmethod
    def is_unfinished(self, state: Any) -> Flag:
        """Check whether the loop continues."""

    @abc.abstractmethod
    def recording(
        self, controller: Controller | None, before: Any, run: ChunkedRun[Any, Any, Any]
    ) -> Recording:
        """Make the recording of a run.

        Args:
            controller: controller of the run; None if an agent chose the actions.
            before: the task's state before the first step.
            run: records, frames and times of the loop; `run.state.task` is the last state.
                `run.common(period)` are the arguments that all recordings share.
        """

    def frame(
        self, state: Any, moment: Moment, inspect: Inspect | None, key: Key
    ) -> dict[str, Any]:
        """Return the arrays of a frame, by field of `frame_type`; none by default.

        Args:
            state: the task's state before `perceive`.
            moment: time of the frame, and the observed state.
            inspect: function that returns the sampled plan of the controller; None to show no plan.
            key: random key of this step's measurements.
        """
        return {}

    def make_frame(self, step: int, arrays: Mapping[str, Any]) -> Frame:
        """Make a frame on the host from the arrays of `frame` after a number of steps.

        Scalars become Python numbers, all other arrays NumPy arrays. Positions are in the
        coordinates of the map.
        """

        def on_host(value: Any) -> Any:
            array = np.asarray(value)
            return array if array.ndim else array.item()

        fields = jax.tree.map(on_host, dict(arrays))
        frame = self.frame_type(step=step, time=step * self.period, **fields)
        return frame.move(self.datum.offset, self.robot.state_names)

    @property
    def steps_per_revision(self) -> int | None:
        """Control periods between two calls of `update_on_host`; None, the default, for no call."""
        return None

    def update_on_host(self, state: LoopState) -> LoopState:
        """Return the state of the loop after work that is not compiled into it, on the host.

        It is for what a library does, such as the optimisation of a pose graph. It is called
        between compiled steps at `steps_per_revision`, so it depends on no length of chunks.

        Args:
            state: state of the loop after a step.
        """
        return state

    def progress(self, state: Any) -> tuple[float, str]:
        """Return the share of the task that is done, from 0 to 1, and a text for the progress
        bar."""
        return 0.0, ""

    def for_batches(self) -> "Scenario":
        """Return the scenario in a form that is efficient under `jax.vmap`."""
        return self

    def blank_records(self, state: Any, controller: Controller | None, capacity: int) -> Any:
        """Allocate a buffer of zero records, with a leading axis of `capacity` steps."""
        nothing = jnp.zeros(())
        members = None
        # The record has one row per member, so its shape depends on the controller.
        if controller is not None and controller.member_names:
            members = Members.blank(len(controller.member_names), self.robot.control_size)
        info = Info(
            jnp.zeros((1, self.robot.control_size)),
            nothing[None],
            nothing[None],
            nothing,
            jnp.array(False),
            members,
        )
        guard = self.driver().init(self.start)
        moment = Moment(
            jnp.zeros((), jnp.int32),
            nothing,
            self.start,
            info.is_finite,
            info.is_finite,
            None if guard is None else self.start,
            guard,
        )
        # Only the shapes are needed, so a constant control and blank diagnostics stand in for the
        # controller, which would be slow to trace.
        _, record = eqx.filter_eval_shape(
            self.advance, state, self.robot.default_control, moment, info
        )
        return jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), record)

    @property
    def steps_per_measurement(self) -> int:
        """Control periods between two measurements."""
        return 1

    @property
    def cell_size(self) -> float:
        """Side of a cell of the belief's map [m]; 1 without a map."""
        return 1.0

    def agent_view(self, view_cells: int | None) -> "AgentView":
        """Return what an environment shows to an agent; by default a view that suits any task.

        Args:
            view_cells: side of the observed square of the map around the robot [cells]; the whole
                map when absent.
        """
        return AgentView(self, view_cells)


class AgentView(eqx.Module):
    """A task as a reinforcement-learning agent sees it: observation, reward, end of an episode.

    The methods here suit any task. To change them for a kind of task, return a subclass from
    `Scenario.agent_view`.

    Args:
        scenario: the task.
        view_cells: side of the observed square of the map around the robot [cells]; the whole map
            when absent; static.
    """

    scenario: Scenario
    view_cells: int | None = eqx.field(static=True)

    def observation(self, state: Any, moment: Moment, belief: Any) -> dict[str, Array]:
        """Return the arrays that an agent observes, by name: by default the observed state.

        Args:
            state: the task's state, as `perceive` returned it.
            moment: the moment that was passed to `perceive`.
            belief: the belief that `perceive` returned.
        """
        return {"state": moment.observed}

    def observation_bounds(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the lower and upper bounds of `observation`, by name."""
        return {"state": state_bounds(self.scenario.robot)}

    def reward(self, before: Any, after: Any) -> Scalar:
        """Return the reward of a transition between two states, both as `perceive` returned them.

        By default minus the elapsed time [s], so that finishing early is best.
        """
        return -self.scenario.control_period * jnp.ones(())

    def is_contact(self, record: Any) -> Flag:
        """Check whether the robot was in contact in a step; by default never."""
        return jnp.array(False)

    def has_ended(self, state: Any, ahead: Any) -> Flag:
        """Check whether an episode is finished at the present state.

        Args:
            state: the task's state now, before `perceive`.
            ahead: the task's state one step later.
        """
        return ~self.scenario.is_unfinished(state)

    def facts(self, state: Any) -> dict[str, Scalar]:
        """Return numbers about the task for an environment's `info`; none by default."""
        return {}

    def picture(self, state: Any, moment: Moment, trail: np.ndarray) -> np.ndarray:
        """Draw the present state (rows, columns, 3) in 256 levels, for `render`.

        By default it is a frame of a recording that has no step yet.

        Args:
            state: the task's state, as `perceive` returned it.
            moment: the moment that was passed to `perceive`.
            trail: (N, 2) positions of the robot so far [m].
        """
        task = self.scenario
        # Without a plan, the key decides only about the noise of a scan that a frame may draw.
        arrays = task.frame(state, moment, None, jax.random.key(0))
        frame = task.make_frame(int(moment.step), arrays)
        pending = jnp.zeros((0, task.robot.control_size))
        loop = LoopState(state, (), moment.step, moment.observed, pending)
        return np.asarray(blank_recording(task, None, loop, frame).frame_image(frame))


def blank_recording(
    scenario: Scenario, controller: Controller | None, state: LoopState, frame: Frame
) -> Recording:
    """Make the recording of a run without a step: its world, its robot and one frame.

    `controller` is None if an agent chooses the actions.
    """
    blank = jax.tree.map(
        lambda leaf: np.zeros((0, *leaf.shape[1:]), leaf.dtype),
        scenario.blank_records(state.task, controller, 1),
    )
    run = ChunkedRun(state, blank, (frame,), Timing(0.0, 0.0, 0, np.zeros(0)), 0, False)
    return scenario.recording(controller, state.task, run)


FAR = 1e6
"""Large value to find bounds: a component that the model does not project back is unbounded."""


def state_bounds(robot: Dynamics) -> tuple[np.ndarray, np.ndarray]:
    """Find the bounds (nx,) to which a model projects its state; infinite where it has none."""
    size = robot.state_size
    low, high = np.full(size, -np.inf, np.float32), np.full(size, np.inf, np.float32)
    if isinstance(robot, ContinuousDynamics):
        for bound, far in ((low, -FAR), (high, FAR)):
            # One component is far at a time: a projection of all together would share a bound, as
            # that of a point mass's speed does.
            held = np.diagonal(jax.vmap(robot.project)(far * jnp.eye(size)))
            is_bound = np.abs(held) < FAR
            bound[is_bound] = held[is_bound]
    return low, high
