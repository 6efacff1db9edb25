"""Smoothness of commands, and counts of events."""

import numpy as np
from jax.typing import ArrayLike

from jaxplore.report._numbers import finite


def command_jerk(controls: ArrayLike, half_range: np.ndarray, period: float) -> float | None:
    """Compute the root mean square of the second differences of commands (N, nu) [1/s^2]:

        (u_{t+1} - 2 u_t + u_{t-1}) / period^2, in halves of the range between their bounds

    None for fewer than three commands.
    """
    commands = np.asarray(controls, np.float64)
    if len(commands) < 3:
        return None
    jerk = np.diff(commands, 2, axis=0) / (half_range * period**2)
    return finite(np.sqrt(np.mean(jerk**2)))


def episodes(flags: ArrayLike) -> int:
    """Count events; successive steps (N,) with the flag set are one event."""
    happens = np.asarray(flags, bool)
    return int((happens & ~np.concatenate([[False], happens[:-1]])).sum())
