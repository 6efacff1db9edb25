"""Why a robot must stand: one rule for the closed loop of a simulation and the pilot of a robot."""

import math
from typing import NamedTuple

import jax.numpy as jnp

from jaxplore._types import Count, Flag, Scalar
from jaxplore.control.plausibility import JUMP_SECONDS, MAX_MISFIT, RETRY_SECONDS

GOOD, LOST, FROZEN, JUMPED, MISFIT, BLIND, REPEATED = range(7)
REASONS = (
    "",
    "the pose is lost",
    "the pose does not change although the robot was told to move",
    "the pose jumped",
    "the scan does not fit the map",
    "the scan is old",
    "the scan does not change although the robot moves",
)
"""Why a robot is stopped, by code; code 0 is none."""
AGE_ROUNDING = 1e-3
"""Error that the age of a measurement may have [s]: times are products in single precision."""


class Evidence(NamedTuple):
    """What the data of a control period say.

    Args:
        elapsed: time since the period before [s].
        is_lost: whether there is no pose, or none that is new enough.
        is_same: whether the pose is that of the period before.
        is_driven: whether the commands that have effect move the robot.
        is_jump: whether the pose is too far from where it should be, or the clock has jumped.
        is_blind: whether there is no scan, or none that is new enough.
        is_scan_same: whether no other scan has come since the period before.
        is_repeat: whether the newest scan repeats the one before it although the odometry says that
            the robot moves.
        misfit: share of the returns of the newest scan that contradict the map, see
            `plausibility.scan_misfit`.
    """

    elapsed: Scalar
    is_lost: Flag
    is_same: Flag
    is_driven: Flag
    is_jump: Flag
    is_blind: Flag
    is_scan_same: Flag
    is_repeat: Flag
    misfit: Scalar


class StopState(NamedTuple):
    """Whether a robot is stopped, and what has led to it.

    Args:
        code: why it is stopped, an index into `REASONS`; 0 if it is not.
        since: time for which it has been stopped for that reason [s].
        still: time for which the pose has been the same although the robot should move [s].
        repeated: time for which no other scan has come although the robot should move [s].
        jump: time since the last jump [s]; infinite before the first.
    """

    code: Count
    since: Scalar
    still: Scalar
    repeated: Scalar
    jump: Scalar

    @classmethod
    def initial(cls) -> "StopState":
        """Return the state of a robot that is not stopped."""
        nothing = jnp.zeros(())
        never = jnp.asarray(math.inf, jnp.float32)
        return cls(jnp.zeros((), jnp.int32), nothing, nothing, nothing, never)


def is_scan_placed(stop: Count) -> Flag:
    """Check whether nothing but scans speaks against a pose: they say there when they fit again."""
    return (stop == GOOD) | (stop == MISFIT) | (stop == BLIND)


def next_stop(state: StopState, found: Evidence, max_frozen: Scalar) -> StopState:
    """Return whether a robot is stopped in a period.

    `state` is that of the period before. `max_frozen` is the time for which a pose or a scan may be
    the same while the robot should move [s]. See `MotionGuard` for the rule.
    """
    since = state.since + found.elapsed
    still = jnp.where(found.is_same & found.is_driven, state.still + found.elapsed, 0.0)
    is_same = found.is_scan_same & found.is_driven
    repeated = jnp.where(is_same, state.repeated + found.elapsed, 0.0)
    jump = jnp.where(found.is_jump, 0.0, state.jump + found.elapsed)
    # A robot that stands has the same pose for ever, so it tries again where its scan fits. A scan
    # that repeats itself has to change first.
    is_waiting = (since < RETRY_SECONDS) | (found.misfit > MAX_MISFIT)
    is_stuck = found.is_same & (state.code == FROZEN) & is_waiting
    is_repeating = found.is_scan_same & (state.code == REPEATED)
    reasons = {
        LOST: found.is_lost,
        FROZEN: (still > max_frozen) | is_stuck,
        JUMPED: jump < JUMP_SECONDS,
        BLIND: found.is_blind,
        REPEATED: ((repeated > max_frozen) & found.is_repeat) | is_repeating,
        MISFIT: found.misfit > MAX_MISFIT,
    }
    code = jnp.select(
        list(reasons.values()),
        [jnp.asarray(each, jnp.int32) for each in reasons],
        jnp.zeros((), jnp.int32),
    )
    return StopState(code, jnp.where(code == state.code, since, 0.0), still, repeated, jump)
