import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import State
from jaxplore.belief.belief import Belief
from jaxplore.costs import StabilityCost, TerrainCost, TraversabilityCost
from jaxplore.geometry import Chassis
from jaxplore.maps import Ground

SIZE = 12
Y, X = np.mgrid[:SIZE, :SIZE] + 0.5  # cells of 1 m
PLANE = 0.3 * X - 0.4 * Y  # as steep as 0.5
APEX = 6.5
CONE = 2.0 - 0.3 * np.hypot(X - APEX, Y - APEX)


@eqx.filter_jit
def _price(cost, state, belief):
    return cost.stage(state, jnp.zeros(2), jnp.zeros(()), belief)


def on(belief: Belief, elevation: np.ndarray, **options) -> Belief:
    return dataclasses.replace(belief, ground=Ground(elevation, 1.0, **options))


def roughness(patch: np.ndarray) -> float:
    """Return the root mean square residual of 3 x 3 cells from the plane that fits them best."""
    y, x = np.mgrid[:3, :3].reshape(2, -1)
    plane = np.stack([np.ones(9), x, y], axis=-1)
    coefficients, *_ = np.linalg.lstsq(plane, patch.ravel(), rcond=None)
    return math.sqrt(np.mean((plane @ coefficients - patch.ravel()) ** 2))


def test_a_plane_costs_its_slope_everywhere(belief, at) -> None:
    plane = on(belief, PLANE, max_slope=1.0, threshold=0.3)
    for here in ((0.1, 0.1), (3.0, 7.7), (6.2, 6.9), (11.9, 5.0)):
        found = float(_price(TerrainCost(steep=0.25, rough=1.0), at(*here), plane))
        assert found == pytest.approx(4.0, rel=1e-4)
        # Half is left: 0.5^2, and 0.2 above the threshold there is no barrier left within 0.2.
        found = float(_price(TraversabilityCost(barrier=8.0, margin=0.2), at(*here), plane))
        assert found == pytest.approx(0.25, rel=1e-4)
        # Within 0.4 the barrier is half as high, squared.
        found = float(_price(TraversabilityCost(barrier=8.0, margin=0.4), at(*here), plane))
        assert found == pytest.approx(0.25 + 8.0 * 0.25, rel=1e-4)


def test_a_cone_costs_its_flank_and_its_bend(belief, at) -> None:
    cone = on(belief, CONE)
    # Along an axis through the apex differences are exact; on the apex they cancel.
    for cell, slope in ((6, 0.0), (7, 0.3), (8, 0.3), (9, 0.3)):
        bend = roughness(CONE[5:8, cell - 1 : cell + 2])
        found = float(_price(TerrainCost(0.6, 0.02), at(cell + 0.5, APEX), cone))
        assert found == pytest.approx((slope / 0.6) ** 2 + bend / 0.02, rel=1e-3, abs=1e-4)
    assert roughness(CONE[5:8, 5:8]) > 0.1 > roughness(CONE[5:8, 8:11])


def test_between_cells_layers_are_interpolated(belief, at) -> None:
    cone = on(belief, CONE)
    first, second = roughness(CONE[5:8, 5:8]), roughness(CONE[5:8, 6:9])
    found = float(_price(TerrainCost(0.3, 0.05), at(6.75, APEX), cone))
    slope = 0.25 * 0.3
    rough = 0.75 * first + 0.25 * second
    assert found == pytest.approx((slope / 0.3) ** 2 + rough / 0.05, rel=1e-3)


@pytest.mark.parametrize(
    ("left", "barrier"), [(1.0, 0.0), (0.45, 0.0), (0.4, 0.0), (0.35, 0.25), (0.3, 1.0), (0.0, 16)]
)
def test_the_barrier_is_one_at_the_threshold(belief, at, left: float, barrier: float) -> None:
    even = np.full((SIZE, SIZE), left)
    given = on(belief, np.zeros((SIZE, SIZE)), threshold=0.3, traversability=even)
    found = float(_price(TraversabilityCost(barrier=5.0, margin=0.1), at(4.0, 4.0), given))
    assert found == pytest.approx((1.0 - left) ** 2 + 5.0 * barrier, rel=1e-4, abs=1e-5)


def test_defaults(belief, at) -> None:
    even = np.full((SIZE, SIZE), 0.35)
    ground = on(belief, PLANE, threshold=0.3, traversability=even)
    assert float(_price(TerrainCost(), at(4.0, 4.0), ground)) == pytest.approx(25 / 9, rel=1e-4)
    expected = 0.65**2 + 10.0 * 0.25
    assert float(_price(TraversabilityCost(), at(4.0, 4.0), ground)) == pytest.approx(expected)
    bump = np.zeros((SIZE, SIZE))
    bump[4, 4] = 0.9
    found = float(_price(TerrainCost(), at(4.5, 4.5), on(belief, bump)))
    assert found == pytest.approx(roughness(bump[3:6, 3:6]) / 0.05, rel=1e-4)


def test_off_the_map_nobody_can_drive(belief, at) -> None:
    ground = on(belief, PLANE)
    assert float(_price(TerrainCost(), at(-3.0, 4.0), ground)) == 0.0
    found = float(_price(TraversabilityCost(10.0, 0.1), at(-3.0, 4.0), ground))
    assert found == pytest.approx(1.0 + 10.0 * (0.4 / 0.1) ** 2, rel=1e-5)


def test_without_ground_it_costs_nothing(belief, at) -> None:
    for cost in (TerrainCost(), TraversabilityCost()):
        assert float(_price(cost, at(4.0, 4.0), belief)) == 0.0


def test_slopes_are_finite_on_level_ground_on_edges_and_far_away(belief, at) -> None:
    robot = at(0.0, 0.0).dynamics

    @jax.jit
    def slopes(values, ground):
        known = dataclasses.replace(belief, ground=ground)

        def along(values):
            state, zero = State(values, robot), jnp.zeros(())
            cost = TerrainCost() + TraversabilityCost()
            return cost.stage(state, jnp.zeros(2), zero, known)

        return jax.grad(along)(values)

    for elevation in (np.zeros((SIZE, SIZE)), CONE):
        ground = Ground(elevation, 1.0)
        for here in ((4.5, 4.5), (6.5, 6.5), (4.0, 4.0), (0.0, 0.0), (-1e6, 1e6)):
            found = slopes(jnp.asarray([*here, 0.0, 0.0, 0.0]), ground)
            assert np.isfinite(found).all(), here
    assert float(slopes(jnp.asarray([6.9, 6.5, 0.0, 0.0, 0.0]), Ground(CONE, 1.0))[0]) != 0.0


def test_the_wheels_of_a_vehicle_stand_on_a_plane(belief, at) -> None:
    # The plane rises by 0.3 along x and falls by 0.4 along y.
    chassis = Chassis(1.2, 0.8, mass_height=0.5, suspension=0.1, offset=0.4)
    stance = eqx.filter_jit(lambda ground, x, yaw: ground.stance(chassis, x, yaw))
    ground = on(belief, PLANE).ground
    for yaw in (0.0, 0.7, -2.0, 3.1):
        found = stance(ground, jnp.asarray([6.3, 5.1]), jnp.asarray(yaw))
        cos, sin = math.cos(yaw), math.sin(yaw)
        assert float(found.ahead) == pytest.approx(0.3 * cos - 0.4 * sin, abs=1e-4)
        assert float(found.left) == pytest.approx(-0.3 * sin - 0.4 * cos, abs=1e-4)
        assert float(found.twist) == pytest.approx(0.0, abs=1e-4)


def test_a_saddle_twists_the_wheels(belief) -> None:
    # z = 0.05 x y, which bilinear interpolation reproduces: the wheels on a diagonal are higher.
    chassis = Chassis(1.2, 0.8)
    ground = on(belief, 0.05 * (X - 6.0) * (Y - 6.0)).ground
    found = ground.stance(chassis, jnp.asarray([6.0, 6.0]), jnp.asarray(0.0))
    assert float(found.twist) == pytest.approx(0.05 * 0.6 * 0.4, abs=1e-6)
    assert float(found.ahead) == pytest.approx(0.0, abs=1e-6)


def test_stability_costs_one_where_a_wheel_leaves_the_ground(belief, at) -> None:
    # On the plane, heading up its gradient: 0.5 ahead, and at rest nothing else.
    chassis = Chassis(1.0, 0.8, mass_height=0.8)
    plane, yaw = on(belief, PLANE, max_slope=1.0), math.atan2(-0.4, 0.3)
    used = 2.0 * 0.8 / 1.0 * 0.5
    for limit in (0.0, 0.5, 0.9):
        found = float(_price(StabilityCost(chassis, limit), at(6.0, 6.0, yaw), plane))
        wanted = (max(used - limit, 0.0) / (1.0 - limit)) ** 2
        assert found == pytest.approx(wanted, rel=1e-3, abs=1e-6)
    edge = dataclasses.replace(chassis, mass_height=jnp.asarray(1.0))
    found = float(_price(StabilityCost(edge, 0.6), at(6.0, 6.0, yaw), plane))
    assert found == pytest.approx(1.0, rel=1e-3)


def test_on_level_ground_a_fast_curve_costs(belief, at) -> None:
    cost = StabilityCost(Chassis(1.0, 0.5, mass_height=0.6), 0.0)
    state = at(6.0, 6.0, 1.0, v=2.0)
    turning = State(state.values.at[4].set(1.5), state.dynamics)
    # 2 h / W v omega / g; the drag of the model slows it down, which counts along the wheelbase.
    across = 2.0 * 0.6 / 0.5 * 2.0 * 1.5 / 9.81
    slowing = float(state.dynamics.acceleration(turning.values, jnp.zeros(2))[0])
    along = 2.0 * 0.6 / 1.0 * slowing / 9.81
    assert float(_price(cost, turning, belief)) == pytest.approx(across**2 + along**2, rel=1e-3)
    assert float(_price(cost, at(6.0, 6.0), belief)) == pytest.approx(0.0, abs=1e-6)
