"""Parts of MPPI by name, in the presets and in their settings."""

from collections.abc import Callable
from typing import Any, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.control import (
    AdaptiveSoftmax,
    ColouredNoise,
    Direct,
    NoiseBank,
    SobolNoise,
    WhiteNoise,
)
from jaxplore.planning.presets import path_following
from jaxplore.planning.presets.explorer import waypoint_mppi
from jaxplore.planning.presets.quadrotor import goal_mppi
from jaxplore.planning.presets.sampling import NOISES, PARAMETERISATIONS, WEIGHTINGS
from jaxplore.settings.controllers import ControllerSettings, InformativeSettings, PortfolioSettings
from jaxplore.settings.defaults import arguments
from jaxplore.settings.sections import NoiseName, ParameterisationName, WeightingName
from jaxplore.tasks.path.settings import ContouringSettings
from jaxplore.tasks.registry import make_settings

ROBOT = jx.DifferentialDrive()
SMALL: dict[str, Any] = {"horizon": 10, "num_samples": 64}
TRACK = jx.race_track()


def explorer(**given: Any) -> Any:
    return jx.explorer(ROBOT, **arguments(ControllerSettings(**SMALL, **given), jx.explorer))


def portfolio(**given: Any) -> Any:
    section = PortfolioSettings(**SMALL, **given)
    return jx.ground_portfolio(ROBOT, **arguments(section, jx.ground_portfolio)).members.mppi


def flight(**given: Any) -> jx.Flight:
    return jx.Flight(**arguments(InformativeSettings(**SMALL, **given), jx.Flight))


def to_goal(**given: Any) -> Any:
    return goal_mppi(ROBOT, [1.0, 0.0], flight(**given))


def contouring(**given: Any) -> Any:
    section = ContouringSettings(**SMALL, comfort_weight=0.0, **given)
    mppi: Any = jx.mpcc(ROBOT, TRACK, **arguments(section, jx.mpcc)).controller
    return eqx.tree_at(lambda each: each.proposal, mppi, mppi.proposal.physical)


MAKERS = {
    "explorer": explorer,
    "portfolio": portfolio,
    "goal": to_goal,
    "contouring": contouring,
}


@pytest.mark.parametrize("name", MAKERS)
def test_a_name_is_a_part(name: str) -> None:
    make, knots = MAKERS[name], 5 if name == "contouring" else 8
    found = {each: make(parameterisation=each) for each in PARAMETERISATIONS}
    kinds = {each: type(mppi.parameterisation) for each, mppi in found.items()}
    assert kinds == {"direct": Direct, "smooth": jx.Smooth, "knots": jx.Knots}
    assert found["knots"].parameterisation.num_knots == knots
    # The sum of the controls has the same spread: of 10 steps, of 5 commands of rates, of knots
    # that each last for 10 / P steps.
    std = {each: np.asarray(mppi.proposal.noise_std) for each, mppi in found.items()}
    np.testing.assert_allclose(
        std["smooth"] * float(found["smooth"].dt), std["direct"] / np.sqrt(5.0), rtol=1e-5
    )
    np.testing.assert_allclose(std["knots"], std["direct"] * np.sqrt(knots / 10.0), rtol=1e-5)
    # The robot and its progress draw apart, which rules out points that both would share.
    noises = path_following.NOISES if name == "contouring" else NOISES
    drawn = {each: type(make(noise=each).proposal.noise) for each in noises}
    known = {
        "gaussian": WhiteNoise,
        "coloured": ColouredNoise,
        "sobol": SobolNoise,
        "bank": NoiseBank,
    }
    assert drawn == {each: known[each] for each in noises}
    numbers = {"temperature": 0.7, "effective_share": 0.25}
    weighting = {each: make(weighting=each, **numbers).weighting for each in WEIGHTINGS}
    assert float(weighting["softmax"].temperature) == pytest.approx(0.7)
    assert float(weighting["adaptive"].effective_sample_size) == pytest.approx(0.25 * 64)
    assert float(weighting["adaptive"].temperature) == pytest.approx(0.7)
    assert float(weighting["adaptive"].importance) == 0.0
    assert float(weighting["elite"].fraction) == pytest.approx(0.25)


def test_parts_of_one_s_own_stay_as_they_are() -> None:
    own: dict[str, Any] = {
        "parameterisation": jx.Knots(3),
        "noise": ColouredNoise(2.0),
        "weighting": jx.Softmax(0.9, 0.5),
    }
    made: Any = jx.explorer(ROBOT, **SMALL, **own)
    found = made.parameterisation, made.proposal.noise, made.weighting
    assert all(a is b for a, b in zip(found, own.values(), strict=True))


def test_the_explorer_s_share_counts_at_least_and_one_sample_does() -> None:
    assert isinstance(jx.explorer(ROBOT, **SMALL).weighting, AdaptiveSoftmax)
    few: Any = jx.explorer(ROBOT, horizon=10, num_samples=4)
    assert float(few.weighting.effective_sample_size) == 1.0
    assert few.parameterisation.num_knots == 8
    short: Any = jx.explorer(ROBOT, horizon=3, num_samples=4)
    assert short.parameterisation.num_knots == 3


def test_another_number_does_not_compile_again() -> None:
    traced: list[None] = []

    @eqx.filter_jit
    def weigh(mppi: Any, costs: jax.Array) -> jax.Array:
        traced.append(None)
        return mppi.weighting.weights(costs, jnp.zeros_like(costs))

    costs = jnp.asarray(np.random.default_rng(0).normal(size=64), jnp.float32)
    sizes = []
    for share in (0.05, 0.5):
        weights = weigh(explorer(effective_share=share, temperature=0.001), costs)
        sizes.append(1.0 / float((weights**2).sum()))
    weigh(explorer(effective_share=0.5, temperature=3.0, noise_std=(0.1, 0.2)), costs)
    np.testing.assert_allclose(sizes, [3.2, 32.0], rtol=0.02)
    assert len(traced) == 1


def test_settings_have_the_names_of_the_presets() -> None:
    assert get_args(ParameterisationName) == PARAMETERISATIONS
    assert get_args(NoiseName) == NOISES
    assert get_args(WeightingName) == WEIGHTINGS
    assert get_args(ContouringSettings.model_fields["noise"].annotation) == path_following.NOISES


@pytest.mark.parametrize("make", [jx.explorer, waypoint_mppi, jx.ground_portfolio])
@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"parameterisation": "spline"}, "'spline'; accepted: direct, smooth, knots"),
        ({"noise": "pink"}, "noise is 'pink'; accepted: gaussian, coloured, sobol, bank"),
        ({"weighting": "best"}, "weighting is 'best'; accepted: softmax, adaptive, elite"),
        ({"weighting": "elite", "temperature": -1.0}, "temperature is -1.0; accepted"),
    ],
)
def test_bad_names_and_numbers_are_refused(
    make: Callable[..., Any], given: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        make(ROBOT, **SMALL, **given)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        (
            {"map": "office", "controller": {"parameterisation": "bent"}},
            "controller.parameterisation is 'bent'; accepted: 'direct', 'smooth' or 'knots'",
        ),
        (
            {"map": "office", "informative": {"noise": "pink"}},
            "informative.noise is 'pink'; accepted: 'gaussian', 'coloured', 'sobol' or 'bank'",
        ),
        (
            {"map": "path", "controller": {"noise": "sobol"}},
            "controller.noise is 'sobol'; accepted: 'gaussian' or 'coloured'",
        ),
        (
            {"map": "office", "portfolio": {"weighting": "soft"}},
            "portfolio.weighting is 'soft'; accepted: 'softmax', 'adaptive' or 'elite'",
        ),
        (
            {"map": "office", "controller": {"effective_share": 2}},
            "controller.effective_share is 2; accepted: less than or equal to 1",
        ),
    ],
)
def test_bad_settings_are_one_line(entries: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        make_settings(entries)
    assert "\n" not in str(caught.value)
