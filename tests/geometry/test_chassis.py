"""A chassis against statics of a rigid body in float64."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jaxplore.geometry import Chassis, Stance

LENGTH, WIDTH, HEIGHT, TRAVEL, G = 0.5, 0.4, 0.3, 0.04, 9.81
CAR = Chassis(LENGTH, WIDTH, HEIGHT, TRAVEL, offset=0.25)
slopes = st.floats(-1.0, 1.0, width=32)
accelerations = st.floats(-6.0, 6.0, width=32)
stance_of = jax.jit(lambda *heights: CAR.stance(*heights))
used_by = jax.jit(lambda *given: CAR.stability(Stance(*given[:3]), *given[3:]))


def scalars(*values: float) -> list[jax.Array]:
    return [jnp.asarray(value, jnp.float32) for value in values]


def transfers(pitch: float, roll: float, ahead: float, left: float) -> tuple[float, float]:
    """Return the load transfers across and along, by the moments of the forces on the centre of
    mass about the edges of the rectangle of the wheels."""
    to_world = Rotation.from_euler("ZYX", [0.0, pitch, roll])
    # Gravity and inertia; the vehicle accelerates in its own plane.
    force = to_world.inv().apply([0.0, 0.0, -G]) - np.array([ahead, left, 0.0])
    mass = np.array([0.0, 0.0, HEIGHT])
    load = -force[2]

    def held(edge: np.ndarray, axis: int) -> float:
        """Return the share of the load on the wheels opposite to an edge."""
        return float(np.cross(mass - edge, force)[axis])

    right = held(np.array([0.0, -WIDTH / 2, 0.0]), 0)
    front = held(np.array([LENGTH / 2, 0.0, 0.0]), 1)
    # Moments about an edge are those of the wheels on the other side, a width or length away.
    on_left, on_rear = -right / WIDTH, -front / LENGTH
    return abs(1.0 - 2.0 * on_left / load), abs(1.0 - 2.0 * on_rear / load)


@given(slopes, slopes, accelerations, accelerations)
def test_load_transfer_is_that_of_a_rigid_body(
    ahead: float, left: float, forwards: float, sideways: float
) -> None:
    stance = Stance(*scalars(ahead, left, 0.0))
    across, along = transfers(float(stance.pitch), float(stance.roll), forwards, sideways)
    used = used_by(*scalars(ahead, left, 0.0, forwards, sideways))
    assert float(used.across) == pytest.approx(across, rel=1e-3, abs=1e-4)
    assert float(used.along) == pytest.approx(along, rel=1e-3, abs=1e-4)
    assert bool(used.is_tipped) == (max(float(used.across), float(used.along)) > 1.0)


def test_it_tips_at_the_angle_of_its_centre_of_mass() -> None:
    for slope, axis in ((WIDTH / (2 * HEIGHT), 1), (LENGTH / (2 * HEIGHT), 0)):
        for share in (0.99, 1.01):
            tilted = [0.0, 0.0, 0.0, 0.0, 0.0]
            tilted[axis] = share * slope
            assert bool(used_by(*scalars(*tilted)).is_tipped) == (share > 1.0)


def test_a_curve_uphill_of_a_side_slope_is_worse() -> None:
    # The left side is higher: turning left pushes the vehicle to the right, downhill.
    used = [float(used_by(*scalars(0.0, 0.3, 0.0, 0.0, side)).across) for side in (-2, 0, 2)]
    assert used[0] < used[1] < used[2]
    # Braking downhill: the acceleration points uphill.
    used = [float(used_by(*scalars(-0.3, 0.0, 0.0, brake, 0.0)).along) for brake in (-2, 0, 2)]
    assert used[0] > used[1] > used[2]


@given(st.lists(st.floats(-0.5, 0.5, width=32), min_size=4, max_size=4))
def test_the_stance_is_the_least_squares_plane(heights: list[float]) -> None:
    x = np.array([1, 1, -1, -1]) * LENGTH / 2
    y = np.array([1, -1, 1, -1]) * WIDTH / 2
    plane = np.stack([x, y, np.ones(4)], axis=-1)
    (ahead, left, middle), *_ = np.linalg.lstsq(plane, np.array(heights), rcond=None)
    off = np.array(heights) - plane @ [ahead, left, middle]
    stance = stance_of(*scalars(*heights))
    assert float(stance.ahead) == pytest.approx(ahead, abs=1e-5)
    assert float(stance.left) == pytest.approx(left, abs=1e-5)
    np.testing.assert_allclose(off, float(stance.twist) * np.array([1, -1, -1, 1]), atol=1e-5)
    used = used_by(*scalars(0.0, 0.0, float(stance.twist), 0.0, 0.0))
    assert float(used.wheels) == pytest.approx(np.abs(off).max() / TRAVEL, abs=1e-4)
    assert bool(used.is_hanging) == (float(used.wheels) > 1.0)


def test_angles_are_those_of_rep_103() -> None:
    # Nose up is a negative pitch, left side up a positive roll.
    stance = Stance(*scalars(math.tan(0.2), 0.0, 0.0))
    assert float(stance.pitch) == pytest.approx(-0.2, abs=1e-6)
    stance = Stance(*scalars(0.0, math.tan(0.3), 0.0))
    assert float(stance.roll) == pytest.approx(0.3, abs=1e-6)
