"""Accelerations, against circles and differences of a simulated drive."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    RK4,
    Ackermann,
    Augmented,
    ComfortCost,
    Dynamics,
    KinematicBicycle,
    PathParameter,
    Quadrotor,
    State,
    Unicycle,
)
from jaxplore.costs.comfort import acceleration

CAR = KinematicBicycle(0.2, 0.1, max_speed=10.0, integrator=RK4())
MODELS = [
    (CAR, [1.0, 2.0, 0.7, 3.0], [1.5, 0.2]),
    (Ackermann(), [1.0, 2.0, -0.7, 3.0, 0.3], [0.5, 0.4]),
    (Augmented(CAR, PathParameter(5.0)), [1.0, 2.0, 0.7, 3.0, 4.0], [-1.5, -0.2, 3.0]),
    (Unicycle(), [0.0, 0.0, 2.0], [0.8, 1.2]),
]


@pytest.mark.parametrize(("model", "state", "control"), MODELS)
def test_it_is_the_second_difference_of_the_position(model: Dynamics, state, control) -> None:
    here, held = jnp.asarray(state), jnp.asarray(control)
    found = np.asarray(jax.jit(lambda x, u: jnp.stack(acceleration(x, u, model)))(here, held))
    h = 0.02
    with jax.enable_x64(True):
        precise = jax.tree.map(lambda leaf: leaf.astype(jnp.float64), model)
        x = jnp.asarray(state, jnp.float64)
        u = jnp.asarray(control, jnp.float64)
        states = [x]
        for _ in range(4):
            states.append(precise.step(states[-1], u, jnp.asarray(h, jnp.float64)))
        p = np.stack([np.asarray(precise.position(each)) for each in states])
    # At the start, one-sided and of third order.
    second = (35 * p[0] - 104 * p[1] + 114 * p[2] - 56 * p[3] + 11 * p[4]) / (12 * h * h)
    yaw = float(model.heading(here))
    turned = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]) @ second
    np.testing.assert_allclose(found, turned, rtol=2e-3, atol=2e-3)


def test_a_circle_costs_its_centripetal_acceleration() -> None:
    robot = Ackermann(wheelbase=0.5, max_speed=10.0)
    radius, v = 0.5 / np.tan(0.3), 4.0
    state = State(jnp.asarray([0.0, 0.0, 1.0, v, 0.3]), robot)
    control = jnp.zeros(2)
    for free, expected in ((0.0, v**2 / radius), (6.0, v**2 / radius - 6.0), (50.0, 0.0)):
        paid = ComfortCost(lateral=2.0, free_lateral=free).stage(
            state, control, jnp.zeros(()), None
        )
        assert float(paid) == pytest.approx((expected / 2.0) ** 2, rel=1e-4)
    braking = ComfortCost(longitudinal=0.5, lateral=1e6).stage(
        state, jnp.asarray([-2.0, 0.0]), jnp.zeros(()), None
    )
    assert float(braking) == pytest.approx(16.0, rel=1e-4)


def test_the_object_that_plans_is_the_one_that_measures() -> None:
    states = jnp.asarray([[0.0, 0.0, 0.0, v, 0.2] for v in (1.0, 2.0, 3.0)])
    controls = jnp.asarray([[1.0, 0.0]] * 3)
    found = ComfortCost().accelerations(states, controls, Ackermann(wheelbase=0.5))
    assert found.shape == (3, 2)
    np.testing.assert_allclose(found[:, 0], 1.0, rtol=1e-5)
    np.testing.assert_allclose(found[:, 1], np.array([1, 4, 9]) * np.tan(0.2) / 0.5, rtol=1e-5)


def test_what_it_cannot_price_is_refused(sled) -> None:
    with pytest.raises(ValueError, match="accelerations are not known"):
        ComfortCost().stage(sled(0.0, 0.0, 1.0), jnp.zeros(1), jnp.zeros(()), None)


def test_it_serves_a_quadrotor() -> None:
    robot = Quadrotor()
    state = State(robot.at_pose(0.0, 0.0, 0.0), robot)
    paid = ComfortCost().stage(state, robot.default_control, jnp.zeros(()), None)
    assert float(paid) == pytest.approx(0.0, abs=1e-6)
