"""The parts of MPPI by name, as presets and settings give them."""

import math
from typing import NamedTuple

import jax
import numpy as np

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_SAMPLES, MOST_STEPS_AHEAD
from jaxplore._types import ArrayLike, Scalar, Vector
from jaxplore._xla import computed
from jaxplore.control.coloured_noise import ColouredNoise
from jaxplore.control.knots import Knots
from jaxplore.control.noise import LEAST_STORED, Noise, NoiseBank, WhiteNoise
from jaxplore.control.parameterisations import Direct, Parameterisation
from jaxplore.control.proposals import GaussianProposal
from jaxplore.control.quasi_random_noise import SobolNoise
from jaxplore.control.smooth import Smooth
from jaxplore.control.weighting import AdaptiveSoftmax, Elite, Softmax, Weighting
from jaxplore.dynamics.base import Dynamics

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
    robot: Dynamics,
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

    Args:
        robot: model of the robot.
        noise_std: (nu,) standard deviations of independent controls, see `spread`.
        horizon: model steps ahead, T.
        num_samples: rollouts, K.
        dt: model step [s].
        parameterisation: parameterisation of the controls, or its name.
        noise: source of noise, or its name.
        weighting: weighting of the rollouts, or its name.
        temperature: temperature of the softmax, the least one of the adaptive softmax.
        effective_share: share of the samples that count.
        importance: weight of the likelihood ratio of "softmax".

    Raises:
        ValueError: an unknown name, a number that is not accepted.
    """
    chosen = parameterisation_by_name(parameterisation, horizon)
    factor = spread(chosen, horizon, dt)
    # Checks the standard deviations, which are scaled afterwards.
    std = GaussianProposal(noise_std).noise_std
    return Sampling(
        GaussianProposal(
            computed(lambda _, factor, std: factor * std, factor, std),
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

    Args:
        given: a parameterisation, or the name of one.
        horizon: model steps ahead, T.
        num_knots: number of knots; at most one for each step is made.

    Raises:
        ValueError: another name, a horizon that is not positive.
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

    With it the sum of the controls over the horizon has the same variance: `sqrt(P / T)` for P
    `Knots`, each of which lasts for T / P steps, and `1 / (dt sqrt(T / 2))` for the rates of
    `Smooth`, which add up from command to command, after T / 2 commands. 1 for any other.

    Args:
        parameterisation: parameterisation of the controls.
        horizon: model steps ahead, T.
        dt: model step [s].

    Raises:
        ValueError: a horizon or a model step that is not positive.
    """
    steps = _checks.positive_int("horizon", horizon, at_most=MOST_STEPS_AHEAD)
    step = _checks.scalar("dt", dt, above=0.0)
    if isinstance(parameterisation, Smooth):
        return computed(lambda _, dt: 1.0 / (dt * math.sqrt(0.5 * steps)), step)
    if isinstance(parameterisation, Knots):
        return computed(lambda _: np.float32(math.sqrt(parameterisation.num_knots / steps)))
    return computed(lambda _: np.float32(1.0))


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

    Args:
        given: a source of noise, or the name of one.
        num_samples: rollouts, K.
        accepted: the names that this controller accepts.

    Raises:
        ValueError: another name.
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

    Args:
        given: a weighting, or the name of one.
        temperature: temperature of the softmax, the least one of the adaptive softmax.
        effective_share: share of the samples that count: the least one with the adaptive softmax,
            that of the elite.
        num_samples: rollouts, K.
        importance: weight of the likelihood ratio of "softmax".

    Raises:
        ValueError: another name, a temperature that is not positive, a share outside (0, 1].
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
        size = computed(lambda xp, share: xp.maximum(share * samples, xp.ones_like(share)), share)
        return AdaptiveSoftmax(size, temperature=heat)
    if given == "elite":
        return Elite(share)
    raise _unknown("weighting", given, WEIGHTINGS)


def _unknown(name: str, given: object, accepted: tuple[str, ...]) -> ValueError:
    return ValueError(f"{name} is {_kinds.described(given)}; accepted: {', '.join(accepted)}")
