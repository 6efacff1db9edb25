"""A physical and a virtual part are each what they are alone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import DifferentialDrive, KinematicBicycle, Quadrotor, State
from jaxplore.dynamics.augmented import Augmented
from jaxplore.dynamics.path_parameter import PathParameter
from jaxplore.geometry.curves import arc_path, line_path

ROBOTS = {"bicycle": KinematicBicycle(), "drive": DifferentialDrive(), "quadrotor": Quadrotor()}
every_robot = pytest.mark.parametrize("name", ROBOTS)
DT = jnp.asarray(0.1)


def augmented(name: str) -> Augmented:
    return Augmented(ROBOTS[name], PathParameter(3.0, end=10.0))


@every_robot
def test_names_sizes_bounds_and_defaults_are_those_of_both(name: str) -> None:
    model, robot = augmented(name), ROBOTS[name]
    assert model.state_names == (*robot.state_names, "phi")
    assert model.control_names == (*robot.control_names, "phi_rate")
    assert model.state_size == robot.state_size + 1
    np.testing.assert_array_equal(model.control_min, [*robot.control_min, 0.0])
    np.testing.assert_array_equal(model.control_max, [*robot.control_max, 3.0])
    np.testing.assert_array_equal(model.default_control, [*robot.default_control, 0.0])
    assert model.radius == robot.radius
    assert model.footprint.radius == robot.footprint.radius


@every_robot
def test_each_part_steps_as_it_does_alone(name: str) -> None:
    model, robot = augmented(name), ROBOTS[name]
    rng = np.random.default_rng(0)
    state = robot.at_pose(1.0, 2.0, 0.5) + jnp.asarray(
        0.1 * rng.random(robot.state_size), jnp.float32
    )
    control = 0.5 * (robot.control_min + robot.control_max) + 0.1
    both, given_both = jnp.append(state, 4.0), jnp.append(control, 2.0)
    reached = jax.jit(lambda x, u: model.step(x, u, DT))(both, given_both)
    np.testing.assert_allclose(reached[:-1], robot.step(state, control, DT), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(reached[-1], 4.2, rtol=1e-6)
    here, alone = State(both, model), State(state, robot)
    np.testing.assert_array_equal(here.position, alone.position)
    assert here.heading == alone.heading
    assert here.speed == alone.speed
    assert here["phi"] == 4.0


@given(st.floats(-5, 15, width=32), st.floats(-9, 9, width=32), st.floats(0.0625, 0.5, width=32))
def test_progress_is_clipped_before_it_counts(phi: float, rate: float, dt: float) -> None:
    model = PathParameter(3.0, end=10.0, min_rate=-1.0)
    reached = model.step(jnp.asarray([phi]), jnp.asarray([rate]), jnp.asarray(dt))
    expected = np.clip(phi + dt * np.clip(rate, -1.0, 3.0), 0.0, 10.0)
    np.testing.assert_allclose(reached[0], expected, rtol=1e-5, atol=1e-6)


def test_progress_ends_where_the_path_does_and_never_on_laps() -> None:
    rate, dt = jnp.asarray([5.0]), jnp.asarray(1.0)
    once = PathParameter.along(line_path([0, 0], [3, 4]), 5.0)
    assert once.step(jnp.asarray([4.0]), rate, dt) == 5.0
    laps = PathParameter.along(arc_path([0, 0, 0], 1.0, 2 * np.pi), 5.0)
    assert laps.step(jnp.asarray([100.0]), rate, dt) == 105.0


def test_a_pose_begins_at_the_start_and_a_wall_stops_the_robot_only() -> None:
    model = augmented("bicycle")
    before = model.at_pose(1.0, 2.0, 0.3)
    np.testing.assert_allclose(before, [1.0, 2.0, 0.3, 0.0, 0.0])
    after = jnp.asarray([2.0, 2.0, 0.4, 1.0, 0.7])
    np.testing.assert_allclose(model.resolve_collision(before, after), [1.0, 2.0, 0.4, 0.0, 0.7])


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: PathParameter(1.0, min_rate=2.0), "min_rate is 2.0; accepted: at most max_rate"),
        (
            lambda: Augmented(
                Augmented(KinematicBicycle(), PathParameter(1.0)), PathParameter(1.0)
            ),
            "state_names of PathParameter has 'phi', which Augmented has; accepted",
        ),
    ],
)
def test_bad_parts(build, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()


@every_robot
def test_another_pose_is_that_of_the_physical_part(name: str) -> None:
    model, robot = augmented(name), ROBOTS[name]
    state, pose = robot.at_pose(1.0, 2.0, 0.5), jnp.array([3.0, -1.0, 0.9])
    moved = model.with_pose(jnp.append(state, 4.0), pose)
    np.testing.assert_array_equal(moved[:-1], robot.with_pose(state, pose))
    assert moved[-1] == 4.0
