"""Wall-clock cost of a run, and versions of the software."""

import dataclasses
import os
import platform
import sys
from importlib.metadata import version

import equinox as eqx
import jax
import numpy as np

from jaxplore._version import __version__
from jaxplore.report._numbers import finite, numbers


@dataclasses.dataclass(frozen=True)
class Timing:
    """Wall-clock times of a run [s]: until the loop is ready for its first step (near 0 if it was
    compiled before), those spent in chunks of the loop and the steps in them, and (N,) those of
    single steps, spread over the run and timed one at a time."""

    compile_seconds: float
    loop_seconds: float
    loop_steps: int
    step_seconds: np.ndarray

    def __add__(self, other: "Timing") -> "Timing":
        """Return the times of a run in two parts."""
        return Timing(
            self.compile_seconds + other.compile_seconds,
            self.loop_seconds + other.loop_seconds,
            self.loop_steps + other.loop_steps,
            np.concatenate([self.step_seconds, other.step_seconds]),
        )


@dataclasses.dataclass(frozen=True)
class Compute:
    """Wall-clock cost of a run; None where nothing was timed.

    Args:
        step_ms_p50: median of the steps timed one at a time [ms].
        step_ms_p99: 99th percentile of these steps [ms].
        loop_step_ms: mean per step of the uninterrupted loop [ms].
        steps_per_second: steps per second of that loop.
        real_time_factor: control period over the mean step; above 1 is faster than real time.
        compile_seconds: time to compile the loop [s].
    """

    step_ms_p50: float | None
    step_ms_p99: float | None
    loop_step_ms: float | None
    steps_per_second: float | None
    real_time_factor: float | None
    compile_seconds: float | None

    def rows(self) -> list[tuple[str, str]]:
        """Return the main numbers as (name, text), for tables."""
        return [
            *numbers("step", "{:.2f} ms p50, {:.2f} ms p99", self.step_ms_p50, self.step_ms_p99),
            *numbers("loop", "{:.2f} ms a step", self.loop_step_ms),
            *numbers("real time", "{:.1f} times as fast", self.real_time_factor),
            *numbers("compilation", "{:.1f} s", self.compile_seconds),
        ]


def compute_cost(timing: Timing, period: float) -> Compute:
    """Compute the wall-clock cost of a run's steps; the control period is in seconds."""
    measured = timing.loop_steps > 0 and timing.loop_seconds > 0.0
    mean = timing.loop_seconds / timing.loop_steps if measured else None
    single = 1e3 * np.asarray(timing.step_seconds, np.float64)
    return Compute(
        step_ms_p50=float(np.percentile(single, 50)) if single.size else None,
        step_ms_p99=float(np.percentile(single, 99)) if single.size else None,
        loop_step_ms=None if mean is None else 1e3 * mean,
        steps_per_second=None if mean is None else 1.0 / mean,
        real_time_factor=None if mean is None else period / mean,
        compile_seconds=finite(timing.compile_seconds),
    )


def software() -> dict[str, str | int | None]:
    """Return the versions of the software, and the machine."""
    return {
        "jaxplore": __version__,
        "jax": jax.__version__,
        "jaxlib": version("jaxlib"),
        "numpy": np.__version__,
        "equinox": eqx.__version__,
        "python": sys.version.split()[0],
        "platform": platform.platform(),
        "device": jax.devices()[0].device_kind,
        "cpu_count": os.cpu_count(),
    }
