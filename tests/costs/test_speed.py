"""Costs that read a speed, with every model: the reference is how fast its position moves."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    Ackermann,
    Augmented,
    Cost,
    DifferentialDrive,
    DiscObstacleCost,
    Dynamics,
    KinematicBicycle,
    Omnidirectional,
    PathParameter,
    PointMass,
    Quadrotor,
    State,
    Unicycle,
)
from jaxplore.control import rollout, rollout_objectives
from jaxplore.costs import BackwardsCost, SpeedLimitCost, extract

pytestmark = pytest.mark.long

LINE = PathParameter(2.0)
ROBOTS: dict[str, Dynamics] = {
    "ackermann": Ackermann(min_speed=-1.0),
    "bicycle": KinematicBicycle(min_speed=-1.0),
    "differential drive": DifferentialDrive(),
    "omnidirectional": Omnidirectional(min_speed=-1.0),
    "point mass": PointMass(2),
    "quadrotor": Quadrotor(),
    "unicycle": Unicycle(min_speed=-1.0),
    "unicycle on a path": Augmented(Unicycle(min_speed=-1.0), LINE),
}
DT = jnp.asarray(0.1)
STEPS = 5


class Arrival(Cost):
    """Speed at the end of the plan, which a robot that parks has to lose."""

    def stage(self, state, control, t, belief):
        return jnp.zeros(())

    def terminal(self, state, belief):
        return jnp.abs(extract.from_physical(extract.speed)(state))


# A wall of one disc, too far away for any term but the reaction time.
LIMIT, SCALE, AWAY, REACTION = 0.05, 0.5, 50.0, 40.0
COSTS = (
    SpeedLimitCost(LIMIT, SCALE),
    DiscObstacleCost([[AWAY, 0.0]], 1.0, reaction_time=REACTION),
    Arrival(),
)
NAMES = ("limit", "wall", "arrival")


def controls_of(robot: Dynamics, seed: int) -> np.ndarray:
    """Return controls (T, nu) that make a robot at rest move."""
    share = np.random.default_rng(seed).uniform(0.5, 0.9, (STEPS, robot.control_size))
    low, high = np.asarray(robot.control_min), np.asarray(robot.control_max)
    return np.asarray(low + share * (high - low), np.float32)


@eqx.filter_jit
def paid_in(robot: Dynamics, controls) -> tuple[Any, ...]:
    """Return what two plans cost, sampled and inspected, the speeds read in their states, and rates
    of positions (2, T, d) [m/s] by the model's step alone, and positions."""
    start = robot.at_pose(0.0, 0.0, 0.0)
    sampled = rollout_objectives(robot, COSTS, start, jnp.moveaxis(controls, 0, -1), DT)
    whole = COSTS[0].with_name("limit") + COSTS[1].with_name("wall") + COSTS[2].with_name("arrival")
    inspected = jax.vmap(lambda each: rollout(robot, whole, start, each, DT))(controls)
    terms = jnp.stack([inspected.terms[name] for name in NAMES])
    states = inspected.states[:, 1:]

    def rate(state, control):
        still = jnp.zeros(())
        return jax.jvp(
            lambda dt: robot.position(robot.step(state, control, dt)), (still,), (still + 1.0,)
        )[1]

    def everywhere(function):
        return jax.vmap(jax.vmap(function))

    read = everywhere(lambda x, u: State(x, robot, u).speed)(states, controls)
    rates = everywhere(rate)(states, controls)
    return sampled, terms, read, rates, everywhere(robot.position)(states)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_a_cost_on_speed_reacts_to_speed(robot: Dynamics) -> None:
    controls = jnp.asarray(np.stack([controls_of(robot, seed) for seed in (0, 1)]))
    sampled, inspected, read, *seen = paid_in(robot, controls)
    rates, places = (np.asarray(each, np.float64) for each in seen)
    speeds = np.linalg.norm(rates, axis=-1)
    np.testing.assert_allclose(np.abs(read), speeds, rtol=1e-4, atol=1e-5)
    over = np.maximum(speeds - LIMIT, 0.0) / SCALE
    room = np.linalg.norm(places - [AWAY, 0.0], axis=-1) - 1.0
    too_close = float(robot.radius) + REACTION * speeds
    deep = np.maximum(too_close + COSTS[1].margin - room, 0.0) / 0.05
    expected = {
        "limit": (over**2).sum(axis=1),
        "arrival": speeds[:, -1],
    }
    for found in map(np.asarray, (sampled, inspected)):
        np.testing.assert_allclose(found[0], expected["limit"], rtol=1e-3)
        np.testing.assert_allclose(found[2], expected["arrival"], rtol=1e-4, atol=1e-6)
        hard = np.asarray(found[1], np.float64)
        wanted = float(COSTS[1].collision) * (deep**2).sum(axis=1)
        np.testing.assert_allclose(hard, wanted, rtol=1e-3, atol=1e-3)
    assert (speeds[:, -1] > LIMIT).all()


@pytest.mark.parametrize(("v", "expected"), [(-0.6, 3.0), (0.0, 0.0), (0.8, 0.0)])
def test_a_unicycle_pays_for_a_command_backwards(v: float, expected: float) -> None:
    robot, control = Unicycle(min_speed=-1.0), jnp.asarray([v, 0.4])
    for model, given in ((robot, control), (Augmented(robot, LINE), jnp.append(control, 1.0))):
        state = State(jnp.zeros(model.state_size), model, given)
        paid = BackwardsCost(scale=0.2).stage(state, given, DT, None)
        assert float(paid) == pytest.approx(expected)


def test_a_state_without_a_control_is_at_rest() -> None:
    assert float(State(jnp.zeros(3), Unicycle()).speed) == 0.0
    augmented = Augmented(Unicycle(), LINE)
    assert float(extract.from_physical(extract.speed)(State(jnp.zeros(4), augmented))) == 0.0
