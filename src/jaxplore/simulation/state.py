"""State of the closed loop, and the moment of a step, which all tasks share."""

from typing import Any, NamedTuple

from jaxtyping import Array, Float

from jaxplore._types import Count, Flag, Scalar, StateVector


class Moment(NamedTuple):
    """Time of a step, and the state that the controller observes.

    Args:
        step: number of steps before it.
        time: time since the start [s].
        observed: (nx,) state that the controller observes.
        is_blind: whether a dropout of measurements is active.
        is_faulty: whether a fault of measurements or odometry is active.
        measured: (nx,) state that was measured, also where the guard does not trust it and the
            observed state is NaN; None without a guard.
        guard: judgement of the guard, or of those of a fleet; None without one.
    """

    step: Count
    time: Scalar
    observed: StateVector
    is_blind: Flag
    is_faulty: Flag
    measured: StateVector | None = None
    guard: Any = None

    @property
    def stop(self) -> Any:
        """Why the guard stops the robot, an index into `control.stops.REASONS`, of a fleet for each
        robot (N,); None without a guard."""
        return None if self.guard is None else self.guard.stop


class LoopState(NamedTuple):
    """State of the closed loop, with the number of steps done.

    `task` is the state of the task, see `Scenario`. `observed` (nx,) is the state that the
    controller observed last. `pending` (D, nu) are the commands that have not taken effect yet,
    oldest first. `drawn` is what disturbances have drawn of the episode, by name, of a fleet for
    each robot; None where none acts. `guard` is the state of the guard, or those of a fleet; None
    without one.
    """

    task: Any
    controller: Any
    step: Count
    observed: StateVector
    pending: Float[Array, "D nu"]
    drawn: Any = None
    guard: Any = None
