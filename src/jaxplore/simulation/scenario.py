"""The protocol of a task: what the closed loop, batches, studies, Gymnasium and reports know."""

import abc
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore._types import ControlVector, Count, Flag, Key, Scalar, StateVector
from jaxplore.control.base import Controller, Info, Members, SampledPlan
from jaxplore.dynamics.base import ContinuousDynamics, Dynamics
from jaxplore.report.metrics import Metrics
from jaxplore.report.recording import Frame, Recording
from jaxplore.simulation.faults import Faults

if TYPE_CHECKING:
    from jaxplore.simulation.chunks import ChunkedRun

type Inspect = Callable[[StateVector, Any], SampledPlan]
"""Looks into a step of the controller, from an observed state and a belief."""


class Moment(NamedTuple):
    """When a step takes place, and what the robot is told about its own state.

    Args:
        step: number of steps done before.
        time: time since the start [s].
        observed: (nx,) state that the controller observes.
        is_blind: whether no measurement arrives.
        is_faulty: whether measurements or odometry fail, by the scenario's faults.
    """

    step: Count
    time: Scalar
    observed: StateVector
    is_blind: Flag
    is_faulty: Flag


class Scenario(eqx.Module):
    """A task in a world: what the robot perceives, what its controls do, when it is finished.

    The closed loop (`jaxplore.simulation.loop`) is the same for all tasks. In each step it calls
    `perceive`, the controller, and `advance`. A task's own state is a NamedTuple, or any pytree,
    whose `robot` (nx,) is the true state of the plant.

    To add a kind of task, implement the abstract methods here, and the recording that `recording`
    returns. Nothing else needs to know of it.
    """

    robot: eqx.AbstractVar[Dynamics]
    """The plant."""
    start: eqx.AbstractVar[StateVector]
    """(nx,) state of the robot at the start."""
    control_period: eqx.AbstractVar[Scalar]
    """Time between controls [s]."""
    faults: eqx.AbstractVar[Faults | None]
    """Faults of the run; None without any."""

    frame_type: ClassVar[type[Frame]] = Frame
    """Class of the frames, whose fields `frame` returns."""
    metrics_type: ClassVar[type[Metrics]] = Metrics
    """Class of the metrics that its recordings compute."""

    @property
    def period(self) -> float:
        """Time between controls [s]: 0.02, not the nearest float32."""
        return round(float(self.control_period), 7)

    @property
    def objective(self) -> str:
        """What a search makes small by default: a sum of metrics, see `jaxplore.study`."""
        return "finished_at"

    @abc.abstractmethod
    def init(self, key: Key | None) -> tuple[Any, Any]:
        """Return the task's state before the first step, and the belief before any measurement.

        Args:
            key: key of the run, for what is drawn at the start; nothing is drawn when absent.
        """

    @abc.abstractmethod
    def perceive(self, state: Any, moment: Moment, key: Key) -> tuple[Any, Any]:
        """Measure, and return the task's state and the belief that the controller reads.

        Args:
            state: the task's state.
            moment: time of the step, and the observed state.
            key: random key of this step's measurements.
        """

    @abc.abstractmethod
    def advance(
        self, state: Any, control: ControlVector, moment: Moment, info: Info
    ) -> tuple[Any, Any]:
        """Apply a control for one period, and return the task's state and the record of the step.

        Args:
            state: the task's state, as `perceive` returned it.
            control: (nu,) control that takes effect.
            moment: the moment that was passed to `perceive`.
            info: diagnostics of the controller's step.
        """

    @abc.abstractmethod
    def is_unfinished(self, state: Any) -> Flag:
        """Say whether the loop goes on."""

    @abc.abstractmethod
    def recording(
        self, controller: Controller | None, before: Any, run: "ChunkedRun[Any, Any, Any]"
    ) -> Recording:
        """Make the recording of a run.

        Args:
            controller: controller of the run; None if an agent chose the actions.
            before: the task's state before the first step.
            run: records, frames and times of the loop; `run.state.task` is the last state. Its
                `common(period)` are the arguments that every recording takes.
        """

    def frame(
        self, state: Any, moment: Moment, inspect: Inspect | None, key: Key
    ) -> dict[str, Any]:
        """Return the arrays of a frame, by field of `frame_type`; none by default.

        Args:
            state: the task's state before `perceive`.
            moment: time of the frame, and the observed state.
            inspect: looks into the controller's step; None if no plan is to be shown.
            key: random key of this step's measurements.
        """
        return {}

    def progress(self, state: Any) -> tuple[float, str]:
        """Return the share of the task that is done, from 0 to 1, and a text that says it."""
        return 0.0, ""

    def for_batches(self) -> "Scenario":
        """Return the scenario in the form that suits many runs side by side."""
        return self

    def blank_records(self, state: Any, controller: Controller | None, capacity: int) -> Any:
        """Return records of zeros to be filled, with a leading axis of `capacity` steps."""
        nothing = jnp.zeros(())
        members = None
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
        moment = Moment(
            jnp.zeros((), jnp.int32), nothing, self.start, info.is_finite, info.is_finite
        )
        # Only the shapes are wanted: neither the measurements nor the controller are traced.
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

    # What an environment for reinforcement learning needs beside the loop. The defaults suit any
    # task; a task that is made for learning says more.

    def observation(
        self, state: Any, moment: Moment, belief: Any, view_cells: int | None
    ) -> dict[str, Array]:
        """Return what an agent observes, by name: by default the state that the robot is told.

        Args:
            state: the task's state, as `perceive` returned it.
            moment: the moment that was passed to `perceive`.
            belief: the belief that `perceive` returned.
            view_cells: side of the square of a map around the robot to observe [cells]; all of the
                map when absent.
        """
        return {"state": moment.observed}

    def observation_bounds(
        self, view_cells: int | None
    ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the least and the greatest values of `observation`, by name."""
        return {"state": state_bounds(self.robot)}

    def reward(self, before: Any, after: Any) -> Scalar:
        """Return the reward for getting from one state, as `perceive` returned it, to another.

        By default minus the time [s], so that it is best to finish early.
        """
        return -self.control_period * jnp.ones(())

    def is_contact(self, record: Any) -> Flag:
        """Say whether the robot touched something in a step; by default it never does."""
        return jnp.array(False)

    def has_ended(self, state: Any, ahead: Any) -> Flag:
        """Say whether an episode is over where the robot is.

        Args:
            state: the task's state now, before `perceive`.
            ahead: the task's state one step later.
        """
        return ~self.is_unfinished(state)

    def facts(self, state: Any) -> dict[str, Scalar]:
        """Return numbers about the task for an environment's `info`; none by default."""
        return {}

    def picture(self, state: Any, moment: Moment, trail: np.ndarray) -> np.ndarray:
        """Draw the task (rows, columns, 3) in 256 levels, for `render`.

        Args:
            state: the task's state, as `perceive` returned it.
            moment: the moment that was passed to `perceive`.
            trail: (N, 2) positions of the robot so far [m].

        Raises:
            NotImplementedError: by default.
        """
        raise NotImplementedError(f"{type(self).__name__} draws no pictures of its state")


FAR = 1e6
"""A state component that a model does not bring back from there has no bound."""


def state_bounds(robot: Dynamics) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds (nx,) to which the model projects each component; infinite without."""
    size = robot.state_size
    low, high = np.full(size, -np.inf, np.float32), np.full(size, np.inf, np.float32)
    if isinstance(robot, ContinuousDynamics):
        for bound, far in ((low, -FAR), (high, FAR)):
            held = np.diagonal(jax.vmap(robot.project)(far * jnp.eye(size)))
            is_bound = np.abs(held) < FAR
            bound[is_bound] = held[is_bound]
    return low, high
