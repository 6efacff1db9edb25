"""The parts of MPPI by name, as presets and settings give them."""

import math
from typing import NamedTuple

import jax
import numpy as np

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_SAMPLES, MOST_STEPS_AHEAD
from jaxplore._types import ArrayLike, Scalar, Vector
from jaxplore._xla import compute
from jaxplore.control.knots import Knots
from jaxplore.control.noise import (
    LEAST_STORED,
    ColouredNoise,
    Noise,
    NoiseBank,
    SobolNoise,
    WhiteNoise,
)
from jaxplore.control.parameterisations import Direct, Parameterisation, Smooth
from jaxplore.control.proposals import GaussianProposal
from jaxplore.control.weighting import AdaptiveSoftmax, Elite, Softmax, Weighting

PARAMETERISATIONS = ("direct", "smooth", "knots")
NOISES = ("gaussian", "coloured", "sobol", "bank")
WEIGHTINGS = ("softmax", "adaptive", "elite")

NUM_KNOTS = 8
"""Knots of the parameterisation "knots"; fewer where the horizon has fewer steps."""


class Sampling(NamedTuple):
    """The three parts of MPPI that vary, as its arguments."""

    proposal: GaussianProposal
    parameterisation: Parameterisation
    weighting: Weighting


def sampling(
    noise_std: Vector,
    *,
    horizon: int,
    num_samples: int,
    dt: ArrayLike,
    parameterisation: Parameterisation | str,
    noise: Noise | str,
    weighting: Weighting | str,
    temperature: ArrayLike,
    effective_share: ArrayLike,
    importance: ArrayLike = 0.0,
) -> Sampling:
    """Build the parts of MPPI from their names and numbers; see the functions below.

    `noise_std` (nu,) are the standard deviations of independent controls, see `spread`.
    """
    chosen = parameterisation_by_name(parameterisation, horizon)
    factor = spread(chosen, horizon, dt)
    # Checks the standard deviations, which are scaled afterwards.
    std = GaussianProposal(noise_std).noise_std
    return Sampling(
        GaussianProposal(
            compute(lambda _, factor, std: factor * std, factor, std),
            noise=noise_by_name(noise, num_samples),
        ),
        chosen,
        weighting_by_name(
            weighting,
            temperature=temperature,
            effective_share=effective_share,
            num_samples=num_samples,
            importance=importance,
        ),
    )


def parameterisation_by_name(
    given: Parameterisation | str, horizon: int, num_knots: int = NUM_KNOTS
) -> Parameterisation:
    """Return the parameterisation with a name, or the given parameterisation unchanged.

    | name | parameterisation |
    | --- | --- |
    | "direct" | `Direct()` |
    | "smooth" | `Smooth()` |
    | "knots" | `Knots(num_knots)`, cubic splines |

    There are at most as many knots as model steps in the horizon.
    """
    if isinstance(given, Parameterisation):
        return given
    steps = _checks.positive_int("horizon", horizon, at_most=MOST_STEPS_AHEAD)
    if given == "direct":
        return Direct()
    if given == "smooth":
        return Smooth()
    if given == "knots":
        return Knots(min(num_knots, steps))
    raise _unknown("parameterisation", given, PARAMETERISATIONS)


def spread(parameterisation: Parameterisation, horizon: int, dt: ArrayLike) -> Scalar:
    """Compute the factor on the standard deviation that independent controls would have.

    With it the sum of the controls over the horizon of T model steps has the same variance:
    `sqrt(P / T)` for P `Knots`, each of which lasts for T / P steps, and `1 / (dt sqrt(T / 2))`
    for the rates of `Smooth`, which add up from command to command, after T / 2 commands. 1 for
    any other. The model step `dt` is in s.
    """
    steps = _checks.positive_int("horizon", horizon, at_most=MOST_STEPS_AHEAD)
    step = _checks.scalar("dt", dt, above=0.0)
    if isinstance(parameterisation, Smooth):
        return compute(lambda _, dt: 1.0 / (dt * math.sqrt(0.5 * steps)), step)
    if isinstance(parameterisation, Knots):
        return compute(lambda _: np.float32(math.sqrt(parameterisation.num_knots / steps)))
    return compute(lambda _: np.float32(1.0))


def noise_by_name(
    given: Noise | str, num_samples: int, accepted: tuple[str, ...] = NOISES
) -> Noise:
    """Return the noise with a name, or the given noise unchanged.

    | name | noise |
    | --- | --- |
    | "gaussian" | `WhiteNoise()` |
    | "coloured" | `ColouredNoise(1.0)` |
    | "sobol" | `SobolNoise()` |
    | "bank" | `NoiseBank`, the same numbers in every controller |

    `accepted` are the names that this controller accepts.
    """
    if isinstance(given, Noise):
        return given
    if given not in accepted:
        raise _unknown("noise", given, accepted)
    if given == "gaussian":
        return WhiteNoise()
    if given == "coloured":
        return ColouredNoise(1.0)
    if given == "sobol":
        return SobolNoise()
    samples = _checks.positive_int("num_samples", num_samples, at_most=MOST_SAMPLES)
    return NoiseBank(max(LEAST_STORED, 16 * samples), key=jax.random.key(0))


def weighting_by_name(
    given: Weighting | str,
    *,
    temperature: ArrayLike,
    effective_share: ArrayLike,
    num_samples: int,
    importance: ArrayLike = 0.0,
) -> Weighting:
    """Return the weighting with a name, or the given weighting unchanged.

    | name | weighting |
    | --- | --- |
    | "softmax" | `Softmax(temperature, importance)` |
    | "adaptive" | `AdaptiveSoftmax(effective_share * K, 0.0, temperature)` |
    | "elite" | `Elite(effective_share)` |

    K is `num_samples`. `effective_share` is the share of the samples that count. For "adaptive",
    share and temperature are the least ones. `importance` is the weight of the likelihood ratio.
    """
    # Checked under any name, so that a bad number is refused wherever it stands.
    heat = _checks.scalar("temperature", temperature, above=0.0)
    share = _checks.scalar("effective_share", effective_share, above=0.0, at_most=1.0)
    samples = _checks.positive_int("num_samples", num_samples, at_most=MOST_SAMPLES)
    if isinstance(given, Weighting):
        return given
    if given == "softmax":
        return Softmax(heat, importance)
    if given == "adaptive":
        size = compute(lambda xp, share: xp.maximum(share * samples, xp.ones_like(share)), share)
        return AdaptiveSoftmax(size, temperature=heat)
    if given == "elite":
        return Elite(share)
    raise _unknown("weighting", given, WEIGHTINGS)


def _unknown(name: str, given: object, accepted: tuple[str, ...]) -> ValueError:
    return ValueError(f"{name} is {_kinds.describe(given)}; accepted: {', '.join(accepted)}")
