"""What a reference is made of, on a map whose ways and hills lead apart."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from jaxplore import Lidar, OccupancyGrid, Perception
from jaxplore.belief.belief import Belief
from jaxplore.belief.guidance import GuidanceField
from jaxplore.maps import ScalarField
from jaxplore.maps.frame import GridFrame
from jaxplore.planning import GradientReference
from jaxplore.planning.strategy.references import ClimbingReference, ReferenceStart, descend

SIZE, RESOLUTION, STEPS = 40, 0.1, 30
FRAME = GridFrame(RESOLUTION)
PERCEPTION = Perception(Lidar(num_beams=8, max_range=1.0), RESOLUTION, 0.15, num_directions=4)
WALK = GradientReference(1.0, STEPS, 0.1)
START = (1.0, 1.0, -2.0)
NAN = math.nan
ROWS, COLUMNS = np.mgrid[:SIZE, :SIZE] + 0.5
TRACES: list[str] = []

init = eqx.filter_jit(lambda grid, pose: PERCEPTION.init(grid, pose))
climb = eqx.filter_jit(lambda walk, *given: walk(*given))


def standing(position) -> ReferenceStart:
    return ReferenceStart(position, jnp.zeros(()), jnp.zeros(()))


@eqx.filter_jit
def go_down(walk, field, belief: Belief, start):
    return descend(walk, field, belief, standing(start))


@eqx.filter_jit
def refer(reference, belief: Belief, potential: ScalarField, start):
    TRACES.append("refer")
    return reference(belief, potential, standing(start))


def believe() -> Belief:
    """Return a room whose far end, behind a wall with a gap, is unknown."""
    p = np.full((SIZE, SIZE), 0.01, np.float32)
    p[0] = p[-1] = p[:, 0] = p[:, -1] = 0.97
    p[:30, 20] = 0.97
    p[1:12, 30:39] = 0.5
    return init(OccupancyGrid(p, RESOLUTION), jnp.asarray([*START[:2], 0.0]))


BELIEF = believe()


def hill(height: float, row: float = 26.0, column: float = 7.0) -> ScalarField:
    square = (ROWS - row) ** 2 + (COLUMNS - column) ** 2
    values = height * np.exp(-0.5 * square / 12.0**2)
    return ScalarField(jnp.asarray(values, jnp.float32), FRAME, jnp.zeros(()))


def at(values: np.ndarray, position: np.ndarray) -> float:
    """Interpolate linearly between the centres of cells, in double precision."""
    x, y = np.asarray(position, np.float64)[:2]
    index = [[y / RESOLUTION - 0.5], [x / RESOLUTION - 0.5]]
    return float(map_coordinates(np.asarray(values, np.float64), index, order=1, mode="nearest")[0])


def paths(potential: ScalarField, start=START) -> tuple[np.ndarray, np.ndarray]:
    """Return the climb and the walk down the guidance field, each from its own parts."""
    start = jnp.asarray(start, jnp.float32)
    guidance = BELIEF.guidance
    down = ScalarField(-guidance.values, guidance.frame, -guidance.outside)
    walks = climb(WALK, potential, BELIEF.grid, start), climb(WALK, down, BELIEF.grid, start)
    return np.asarray(walks[0]), np.asarray(walks[1])


def reference(min_gain: float = 1.0, potential: ScalarField | None = None, start=START):
    field = hill(10.0) if potential is None else potential
    start = jnp.asarray(start, jnp.float32)
    return np.asarray(refer(ClimbingReference(WALK, min_gain), BELIEF, field, start))


def test_climbs_or_follows_as_the_end_of_the_climb_is_worth_more() -> None:
    for height in (0.5, 10.0, 200.0):
        potential = hill(height)
        climbing, guided = paths(potential)
        gain = at(potential.values, climbing[-1]) - at(potential.values, guided[-1])
        assert gain > 0.1 * height
        np.testing.assert_array_equal(reference(0.999 * gain, potential), climbing)
        np.testing.assert_array_equal(reference(1.001 * gain, potential), guided)
    assert np.linalg.norm(climbing[-1] - guided[-1]) > 0.5


def test_the_climb_ends_higher_and_the_guided_walk_nearer_to_what_remains() -> None:
    potential = hill(10.0)
    climbing, guided = reference(1.0, potential), reference(1e6, potential)
    guidance = BELIEF.guidance.values
    stride = round(BELIEF.guidance.frame.resolution / RESOLUTION)

    def to_go(position: np.ndarray) -> float:
        return at(guidance, np.asarray(position) / stride)

    start = np.asarray(START)
    assert at(potential.values, climbing[-1]) > at(potential.values, start) + 1.0
    # Three metres of way: all of them nearer, but for the detour of a lattice's eight directions.
    assert to_go(guided[-1]) < to_go(start) - 0.8 * STEPS * 0.1
    heights = [to_go(position) for position in (start, *guided)]
    assert (np.diff(heights) < 1e-4).all()


@pytest.mark.parametrize("potential", [0.0, 3.0, NAN], ids=["nothing", "flat", "not a number"])
def test_where_there_is_nothing_to_climb_it_follows_guidance(potential: float) -> None:
    field = ScalarField(jnp.full((SIZE, SIZE), potential), FRAME, jnp.zeros(()))
    _, guided = paths(hill(1.0))
    np.testing.assert_array_equal(reference(0.0, field), guided)
    assert np.isfinite(guided).all()
    assert np.linalg.norm(guided[-1] - np.asarray(START)) > 0.5


@given(st.floats(0.4, 1.7), st.floats(0.4, 3.6), st.floats(0.0, 30.0), st.floats(0.0, 5.0))
@settings(max_examples=20)
def test_no_wall_is_entered_and_the_speed_is_kept(x, y, height, min_gain) -> None:
    path = reference(min_gain, hill(height, 10.0, 30.0), (x, y, 1.5))
    assert path.shape == (STEPS, 3)
    np.testing.assert_array_equal(path[:, 2], 1.5)
    path = np.concatenate([np.float32([[x, y, 1.5]]), path])[:, :2]
    assert (np.linalg.norm(np.diff(path, axis=0), axis=1) <= 0.1 + 1e-5).all()
    rows, columns = np.floor(path.T[::-1] / RESOLUTION).astype(int)
    assert (np.asarray(BELIEF.grid.probability)[rows, columns] <= 0.65).all()


@pytest.mark.parametrize(
    "start", [(NAN, NAN, NAN), (NAN, 1.0, 0.0), (-1.0, 2.0, 0.0), (math.inf, 1.0, 0.0)]
)
def test_a_robot_that_is_nowhere_stays(start) -> None:
    path = reference(1.0, hill(10.0), start)
    np.testing.assert_array_equal(path, np.tile(np.float32(start), (STEPS, 1)))


def test_follow_goes_straight_down_a_slope_and_stops_at_the_bottom() -> None:
    """Twenty cells to the column of the least cost, two metres at 1 m/s."""
    values = jnp.asarray(np.abs(COLUMNS - 12.5) * RESOLUTION, jnp.float32)
    field = GuidanceField(values, jnp.zeros((2, SIZE, SIZE)), FRAME, jnp.asarray(1e4))
    open_map = eqx.tree_at(lambda b: b.grid.probability, BELIEF, jnp.full((SIZE, SIZE), 0.01))
    path = np.asarray(go_down(WALK, field, open_map, jnp.asarray([3.25, 2.0, 1.0])))
    expected = np.maximum(3.25 - 0.1 * np.arange(1, STEPS + 1), 1.25)
    np.testing.assert_allclose(path[:, 0], expected, atol=0.06)
    np.testing.assert_allclose(path[:, 1:], [[2.0, 1.0]] * STEPS, atol=1e-5)
    np.testing.assert_array_equal(path[-1], path[-2])


def test_gain_and_walk_are_data() -> None:
    reference(1.0)
    before = len(TRACES)
    for min_gain, speed, dt in ((0.0, 1.0, 0.1), (2.0, 3.0, 0.1), (9.0, 1.0, 0.02)):
        made = ClimbingReference(GradientReference(speed, STEPS, dt), min_gain)
        refer(made, BELIEF, hill(min_gain), jnp.asarray(START))
    assert len(TRACES) == before


def test_defaults_are_the_notes_numbers() -> None:
    walk = ClimbingReference().gradient_reference
    assert walk.num_steps == 40
    np.testing.assert_allclose([walk.speed, walk.dt], [2.0, 0.05])
