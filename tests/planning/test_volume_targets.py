"""Frontiers and targets in a volume, against SciPy and in the closed loop."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage
from tests.kinds import room

import jaxplore as jx
from jaxplore import planning
from jaxplore.belief.volume import VolumePerception
from jaxplore.belief.volume_lattice import NODE
from jaxplore.planning.strategy.target_controller import PATIENCE, RADIUS
from jaxplore.planning.strategy.target_rules import NearestCluster, NearestFrontier
from jaxplore.simulation.loop import run_chunk

pytestmark = pytest.mark.long

SIDE = 0.2
ROBOT = jx.Quadrotor()
CAMERA = jx.DepthCamera(32, 24)
FEW = {"horizon": 20, "num_samples": 128}


def scenario(**more) -> jx.VolumeScenario:
    return jx.VolumeScenario(room(column=20), ROBOT, CAMERA, (1.2, 2.8, 1.2, 0.3), **more)


@pytest.fixture(scope="module")
def explored():
    """Return a controller and the belief after a few scans from the start, with its fields."""
    given = scenario()
    controller = planning.volume_target_explorer(
        ROBOT, "nearest-cluster", given.perception, given.world, **FEW
    )
    run = jx.simulate(controller, given, 8, key=jax.random.key(0))
    from jaxplore.simulation.loop import initial_loop_state

    initial = initial_loop_state(controller, given, jax.random.key(0))
    state = run.checkpoint.state(given, initial)
    return controller, state.task


@eqx.filter_jit
def choose(controller, state, robot, belief, key):
    """Return what a step chooses, without the command, which is not computed then."""
    after = controller.step(state, robot, belief, key=key)[1]
    return after._replace(tracker=state.tracker)


@eqx.filter_jit
def shown(controller, robot, belief, key):
    """Return the reference of a look."""
    return controller.inspect(controller.init(), robot, belief, key=key).reference


def test_frontiers_are_free_voxels_beside_unknown_ones(explored) -> None:
    controller, task = explored
    belief, perception = task.belief, controller.perception
    found = eqx.filter_jit(controller.find)(belief, task.robot)
    # A coarser voxel is free if all of its voxels are, and occupied if one of them is.
    assert perception.pool == 1
    is_free, is_occupied = np.asarray(belief.grid.is_free), np.asarray(belief.grid.is_occupied)
    unknown = ~is_free & ~is_occupied
    cross = ndimage.generate_binary_structure(3, 1)
    frontier = is_free & ndimage.binary_dilation(unknown, cross)
    labels, number = ndimage.label(frontier, np.ones((3, 3, 3)))
    sizes = np.bincount(labels.reshape(-1), minlength=number + 1)[labels] * frontier
    width = 2 * NODE * controller.blocks_to_unknown + 1
    count = ndimage.convolve(frontier.astype(float), np.ones((width,) * 3), mode="constant")
    largest = ndimage.maximum_filter(sizes, width, mode="constant")
    nodes = tuple(slice(1, None, NODE) for _ in range(3))
    shape = tuple(slice(size) for size in found.distance.shape)
    worth = np.asarray(found.worth)
    is_view = np.asarray(found.is_view)
    for mask, cells in ((found.is_frontier, count), (found.is_cluster, largest)):
        enough = cells[nodes][shape] * SIDE**2 >= float(controller.min_frontier) - 1e-6
        np.testing.assert_array_equal(np.asarray(mask), is_view & enough)
    assert np.asarray(found.is_cluster).any()
    # A view is as good as its best heading.
    np.testing.assert_array_equal(worth, np.asarray(belief.information.values).max(axis=0))
    assert (worth[is_view] >= float(controller.min_information)).all()
    # Every candidate is open, and no path is shorter than the straight line.
    straight = np.asarray(found.roads.distances(jnp.asarray([1.2, 2.8, 1.2])))
    reached = np.isfinite(np.asarray(found.distance))
    assert np.asarray(found.roads.is_open)[is_view].all()
    assert (np.asarray(found.distance)[reached] >= straight[reached] - 0.25).all()


def test_the_guidance_of_the_tracker_leads_to_the_target(explored) -> None:
    controller, task = explored
    key = jax.random.key(1)
    # Without weak types, so that the state of later steps is the same program.
    begin = jax.tree.map(lambda leaf: jnp.asarray(leaf, leaf.dtype), controller.init())
    state = choose(controller, begin, task.robot, task.belief, key)
    assert bool(state.has_target)
    values = np.asarray(state.guidance.values)
    np.testing.assert_array_equal(np.unravel_index(values.argmin(), values.shape), state.node)
    assert values.min() == 0.0
    found = eqx.filter_jit(controller.find)(task.belief, task.robot)
    candidates = np.asarray(found.is_cluster) & (
        (np.asarray(found.distance) > float(controller.near)) | np.asarray(found.is_view)
    )
    distance = np.where(candidates, np.asarray(found.distance), np.inf)
    assert distance[tuple(np.asarray(state.node))] == distance.min()
    # A robot that comes no nearer to a target goes elsewhere.
    far = np.unravel_index(np.where(candidates, distance, -1.0).argmax(), distance.shape)
    assert distance[far] > float(controller.near)
    waited = state.progress._replace(
        best=jnp.asarray(distance[far]), waiting=jnp.asarray(PATIENCE - 1, jnp.int32)
    )
    still = state._replace(
        node=jnp.asarray(far, jnp.int32), progress=waited, since=jnp.zeros((), jnp.int32)
    )
    other = choose(controller, still, task.robot, task.belief, key)
    gap = np.linalg.norm(np.asarray(other.node) - far) * state.guidance.spacing
    assert not bool(other.has_target) or gap > RADIUS
    assert int(other.progress.stalls) == 1
    reference = shown(controller, task.robot, task.belief, key)
    np.testing.assert_allclose(reference[0], state.guidance.place(state.node)[:2])


def test_rules_explore_the_hall_with_one_program() -> None:
    given = scenario(target_coverage=0.9)
    run = None
    for rule in (NearestCluster(0.5), NearestCluster(0.7)):
        controller = planning.volume_target_explorer(
            ROBOT, rule, given.perception, given.world, **FEW
        )
        before = run_chunk._cached._cache_size()
        run = jx.simulate(controller, given, 400, key=jax.random.key(2))
        assert run.metrics.is_finished
        assert run.metrics.collisions == 0
    assert run_chunk._cached._cache_size() == before


def test_a_lidar_that_sees_all_around_does_not_stay() -> None:
    perception = VolumePerception([jx.RingLidar(4, 24)], SIDE, 0.3)
    world = room(column=20)
    around = planning.volume_target_explorer(ROBOT, NearestFrontier(), perception, world, **FEW)
    assert not around.stays
    weights = jx.get_parameters(around)
    assert any(float(each) == 0.0 for name, each in weights.items() if "information" in name)
    camera = VolumePerception([CAMERA], SIDE, 0.3)
    assert planning.volume_target_explorer(ROBOT, "wander", camera, world, **FEW).stays
