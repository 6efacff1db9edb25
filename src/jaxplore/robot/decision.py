"""The command of a control period: a controller, and the guard that watches over it."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxplore._types import ControlVector, Key, Scalar, StateVector
from jaxplore.belief.tracks import Tracks
from jaxplore.control.base import Controller, Info
from jaxplore.control.guard import GuardState, MotionGuard, ScanPoints
from jaxplore.control.latency import LatencyCompensation
from jaxplore.control.stops import GOOD, LOST
from jaxplore.control.validation import Validated
from jaxplore.dynamics.base import Dynamics


class Decided(NamedTuple):
    """A command that is sent to the robot's base, with the states of controller and guard after it.

    `control` (nu,) is not finite where the base is told to brake. `guard` is None without a guard.
    A fleet has the states of all its guards there.
    """

    control: ControlVector
    memory: Any
    guard: Any
    info: Info


class Driver(NamedTuple):
    """Decides which command is sent in each control period; `period` is its length [s].

    The guard stops the robot where its pose, scan or motion cannot be true; None without one. A
    driver without a controller only judges.
    """

    model: Dynamics
    controller: Controller | None
    guard: MotionGuard | None
    period: Scalar

    def init(self, start: StateVector) -> GuardState | None:
        """Return the state of the guard of a robot at rest (nx,); None without a guard."""
        return None if self.guard is None else self.guard.init(self.model, start)

    def judge(
        self,
        watch: GuardState | None,
        observed: StateVector,
        last: StateVector,
        points: ScanPoints,
        time: Scalar,
    ) -> tuple[StateVector, GuardState | None]:
        """Return the observed state (nx,), NaN where the guard does not trust it, and the guard's
        state; see `MotionGuard.judge`."""
        if self.guard is None or watch is None:
            return observed, watch
        judged = self.guard.judge(self.model, watch, observed, last, points, time, self.period)
        return jnp.where(judged.stop == GOOD, observed, jnp.nan), judged

    def decide(
        self,
        memory: Any,
        watch: GuardState | None,
        observed: StateVector,
        belief: Any,
        points: ScanPoints,
        time: Scalar,
        key: Key,
    ) -> Decided:
        """Return the command of a period.

        `memory` is the state of the controller, and `observed` (nx,) the state that the robot takes
        to be its own. `watch` is None without a guard. `time` is the present time [s].
        """
        guard, controller = self.guard, self.controller
        assert controller is not None
        if guard is None or watch is None:
            control, memory, info = controller.step(memory, observed, belief, key=key)
            return Decided(control, memory, watch, info)
        is_stopped = watch.stop != GOOD
        # A controller that compensates for a latency itself needs no prediction for it.
        latency = (
            controller.latency if isinstance(controller, LatencyCompensation) else 0.0 * self.period
        )
        known = jnp.round(latency / self.period).astype(jnp.int32)
        ahead = guard.predict(self.model, watch, known, self.period)
        start = jnp.where(is_stopped, jnp.nan, ahead)
        delay = guard.delay(watch, jnp.zeros((), jnp.int32)).astype(jnp.float32)
        age = time - points.time + delay * self.period
        checked, after, info = self.plan(memory, start, belief, points, age, key)
        control = checked.control
        # The controller starts anew from rest: its plan was not executed.
        after = jax.tree.map(functools.partial(jnp.where, is_stopped), controller.init(), after)
        watch = guard.add_command(self.model, watch, control)
        # A plan that was not asked for is no failure of the controller.
        is_finite = info.is_finite | (is_stopped & (watch.stop != LOST))
        return Decided(control, after, watch, info._replace(is_finite=is_finite))

    def plan(
        self,
        memory: Any,
        start: StateVector,
        belief: Any,
        points: ScanPoints,
        age: Scalar,
        key: Key,
    ) -> tuple[Validated, Any, Info]:
        """Return the command that is planned from the state (nx,) in which it takes effect.

        The guard, which there must be, has slowed it down where somebody can be hidden, and checked
        it against the newest scan. `age` is the time from the scan to the effect of the command
        [s]. The state of the controller after it and what it says follow.
        """
        assert self.guard is not None
        assert self.controller is not None
        control, memory, info = self.controller.step(memory, start, belief, key=key)
        # A command that is not finite is none: the robot's base then brakes.
        control = jnp.where(jnp.isfinite(start).all(), control, jnp.nan)
        tracks: Tracks | None = getattr(belief, "tracks", None)
        edges = None if tracks is None else tracks.edges
        control = self.guard.slow_down(self.model, start, control, edges, self.period)
        checked = self.guard.keep_clear(self.model, start, control, points, age, self.period)
        return checked, memory, info

    def actuate(
        self,
        watch: GuardState | None,
        control: ControlVector,
        measured: StateVector,
        points: ScanPoints,
    ) -> tuple[ControlVector, GuardState | None]:
        """Return what the robot's base does in a period, and where the guard expects the robot.

        A command that is not finite tells the base to brake. It does so along the points of the
        newest scan. Of the state `measured` (nx,) the base measures all but the pose.
        """
        guard = self.guard
        if guard is None or watch is None:
            return control, watch
        before = watch
        # A loop of one iteration or none. Under vmap a branch would be taken in every step of every
        # run, while a loop is skipped if no run brakes.
        control = jax.lax.fori_loop(
            0,
            jnp.where(jnp.isfinite(control).all(), 0, 1),
            lambda *_: guard.brake(self.model, before, measured, points, self.period),
            control,
        )
        return control, guard.advance(self.model, watch, measured, control, self.period)
