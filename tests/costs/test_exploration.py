import math

import jax.numpy as jnp
import pytest

from jaxplore import Cost, GuidanceCost, InformationCost


def test_information_cost_is_per_beam(stage, at) -> None:
    assert stage(InformationCost(), at(4.0, 3.5)) == pytest.approx(-3 * 3.0 / 10)
    assert stage(InformationCost(), at(-4.0, 3.5)) == 0.0


def test_guidance_cost_is_the_cost_to_go_and_of_facing_elsewhere(stage, at) -> None:
    for yaw in (0.0, 1.0, math.pi, -2.0):
        facing = 0.6 * math.cos(yaw) + 0.8 * math.sin(yaw)
        expected = 2.0 * 3.5 - 2.5 + 0.5 * (1.0 - facing)
        found = stage(GuidanceCost(turning=0.5), at(4.0, 3.0, yaw))
        assert found == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("cost", [InformationCost(), GuidanceCost()])
def test_the_same_cost_serves_another_model(cost: Cost, stage, at, sled, belief) -> None:
    expected = stage(cost, at(4.0, 3.0, v=0.7))
    found = cost.stage(sled(4.0, 3.0, 0.7), jnp.zeros(1), jnp.asarray(0.1), belief)
    assert float(found) == pytest.approx(expected)


def test_bad_input_is_named() -> None:
    with pytest.raises(ValueError, match=r"turning is -0.1; accepted"):
        GuidanceCost(turning=-0.1)
