import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.tasks.path.settings import make_path_settings
from jaxplore.tasks.registry import build, make_settings


def cost() -> jx.WaypointCost:
    return jx.WaypointCost(jnp.array([1.0, 2.0]))


def controller(whole, temperature=0.5) -> jx.MPPI:
    return jx.MPPI(
        jx.Unicycle(),
        whole,
        horizon=4,
        num_samples=8,
        temperature=temperature,
        noise_std=[0.1, 0.2],
    )


@pytest.fixture(scope="module")
def example() -> jx.MPPI:
    return controller(2.0 * cost() + 3.0 * cost().with_name("other") + jx.ControlRateCost())


def test_paths_are_the_names_of_fields_and_of_costs(example) -> None:
    found = jx.get_parameters(example)
    assert found["weighting.temperature"] == 0.5
    np.testing.assert_allclose(found["proposal.noise_std"], [0.1, 0.2])
    assert found["cost.waypoint.weight"] == 2.0
    assert found["cost.other.weight"] == 3.0
    np.testing.assert_allclose(found["cost.other.waypoint"], [1.0, 2.0])
    assert "cost.control-rate.weight" not in found  # it has none


def test_every_small_float_array_has_a_path(example) -> None:
    """All that JAX finds, and by a name that leads back to it."""
    arrays = jax.tree.leaves(eqx.filter(example, eqx.is_inexact_array))
    found = jx.get_parameters(example)
    assert len(found) == len(arrays)
    for path in found:
        changed = jx.set_parameters(example, {path: 7.25})
        assert (np.asarray(jx.get_parameters(changed)[path]) == 7.25).all()
        others = {name for name in found if name != path}
        same = [np.array_equal(jx.get_parameters(changed)[name], found[name]) for name in others]
        assert all(same)


def test_weights_in_each_other_and_alike_costs_are_told_apart() -> None:
    twice = controller(2.0 * (3.0 * cost()) + 4.0 * cost())
    assert jx.get_parameters(twice)["cost.waypoint.weight-2"] == 2.0
    assert jx.get_parameters(twice)["cost.waypoint.weight"] == 3.0
    assert jx.get_parameters(twice)["cost.waypoint-2.weight"] == 4.0
    whole = controller(5.0 * (2.0 * cost() + 1.0 * jx.ControlRateCost()))
    assert jx.get_parameters(whole)["cost.weight"] == 5.0
    assert jx.get_parameters(whole)["cost.waypoint.weight"] == 2.0
    assert jx.get_parameters(controller(6.0 * cost()))["cost.weight"] == 6.0


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("weighting.temperature", "weighting.temperature"),
        ("controller.temperature", "weighting.temperature"),
        ("temperature", "weighting.temperature"),
        ("controller.proposal.noise_std", "proposal.noise_std"),
        ("cost.other.weight", "cost.other.weight"),
    ],
)
def test_names_in_between_may_be_left_out(example, given, meant) -> None:
    assert jx.find_parameter(example, given) == meant


def test_what_is_not_there_is_named_with_what_is_near(example) -> None:
    with pytest.raises(ValueError, match=r"weighting.temperatur is not known; .*weighting.temp"):
        jx.find_parameter(example, "weighting.temperatur")
    with pytest.raises(
        ValueError, match=r"cost.weight may be any of cost.waypoint.weight, cost.ot"
    ):
        jx.find_parameter(example, "cost.weight")
    with pytest.raises(ValueError, match=r"noise_std has shape \(3,\); accepted: one number, or"):
        jx.set_parameters(example, {"proposal.noise_std": [1.0, 2.0, 3.0]})
    with pytest.raises(ValueError, match=r"temperature is nan; accepted: finite"):
        jx.set_parameters(example, {"weighting.temperature": float("nan")})


def test_other_numbers_compile_nothing_anew(example) -> None:
    traces = 0

    @eqx.filter_jit
    def plan(controller: jx.MPPI) -> jax.Array:
        nonlocal traces
        traces += 1
        control, *_ = controller.step(controller.init(), jnp.zeros(3), key=jax.random.key(0))
        return control

    first = plan(example)
    second = plan(jx.set_parameters(example, {"temperature": 50.0, "cost.other.weight": 0.1}))
    assert traces == 1
    assert not np.array_equal(first, second)
    # The same as one that was built so.
    costs = 2.0 * cost() + 0.1 * cost().with_name("other") + jx.ControlRateCost()
    built = controller(costs, temperature=50.0)
    np.testing.assert_array_equal(second, plan(built))


def test_settings_reach_the_controller_by_path() -> None:
    settings = make_settings(
        {"map": "office", "parameters": {"cost.information.weight": 7.0, "noise_std": [0.3, 0.4]}}
    )
    found = jx.get_parameters(build(settings).controller)
    assert found["cost.information.weight"] == 7.0
    # A parameter that a setting sets is stored under the setting's name.
    assert settings.controller.information_weight == 7.0
    assert list(settings.parameters) == ["noise_std"]
    np.testing.assert_allclose(found["proposal.noise_std"], [0.3, 0.4])
    settings = make_path_settings({"parameters": {"cost.comfort.weight": 3.0}})
    assert jx.get_parameters(build(settings).controller)["cost.comfort.weight"] == 3.0
    assert settings.controller.comfort_weight == 3.0
    # The weight of progress per metre is another number than the parameter, which has `dt` in it.
    kept = make_path_settings({"parameters": {"cost.progress.weight": 3.0}})
    assert kept.parameters == {"cost.progress.weight": 3.0}
    with pytest.raises(ValueError, match=r"controller.information_weight is -1"):
        make_settings({"map": "office", "parameters": {"cost.information.weight": -1}})
    # An explorer that drives by rules holds the controller inside of another one.
    other = {"map": "office", "architecture": "nearest-frontier"}
    named = {"parameters": {"cost.guidance.weight": 2.0}}
    assert make_settings({**other, **named}).parameters == named["parameters"]
    with pytest.raises(ValueError, match=r"parameter cost.nothing is not known"):
        build(make_settings({"map": "office", "parameters": {"cost.nothing": 1.0}}))
