"""Informative MPPI in a volume: its reference against NumPy, its plan, and the closed loop."""

import dataclasses
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from tests.kinds import room

import jaxplore as jx
from jaxplore import planning
from jaxplore.belief.volume import VolumePerception
from jaxplore.control.mixtures import BiasedProposal
from jaxplore.costs import PotentialCost, StrategyReferenceCost
from jaxplore.dynamics.base import State
from jaxplore.planning import QuadrotorFollower, VolumeInformativeMPPI, VolumeReference
from jaxplore.planning.presets.volume import ARCHITECTURES
from jaxplore.planning.strategy.volume_reference import FLAT
from jaxplore.simulation.loop import run_chunk

pytestmark = pytest.mark.long

SIDE = 0.2
ROBOT = jx.Quadrotor()
CAMERA = jx.DepthCamera(32, 24)
FEW: dict[str, Any] = {"horizon": 20, "num_samples": 128}
PERCEPTION = VolumePerception([CAMERA], SIDE, 0.3)
REQUIRED = float(PERCEPTION.required)
PACE = VolumeReference(1.8, 40)
every = pytest.mark.parametrize("architecture", ARCHITECTURES)


def controller_of(architecture: str, **more: Any) -> VolumeInformativeMPPI:
    given = {"perception": PERCEPTION, "grid": room(column=20), **FEW, **more}
    return planning.volume_informative_mppi(ROBOT, architecture, **given)


def scenario(**more: Any) -> jx.VolumeScenario:
    return jx.VolumeScenario(
        room(column=20), ROBOT, CAMERA, (1.2, 2.8, 1.2, 0.3), perception=PERCEPTION, **more
    )


@pytest.fixture(scope="module")
def controllers() -> dict[str, VolumeInformativeMPPI]:
    return {name: controller_of(name) for name in ARCHITECTURES}


# The reference


@pytest.fixture(scope="module")
def known() -> jx.belief.VolumeBelief:
    """Return the belief of a robot that knows the hall, and is led to a node beyond the wall."""

    @eqx.filter_jit
    def begin(grid):
        belief = PERCEPTION.init(grid, jnp.asarray([1.2, 2.8, 1.2]))
        shape = belief.guidance.values.shape
        source = jnp.full(shape, jnp.inf).at[2, 2, 16].set(0.0)
        guidance = PERCEPTION.roads(belief).field(source)
        return eqx.tree_at(lambda each: each.guidance, belief, guidance)

    return begin(room(column=20))


@eqx.filter_jit
def descend(reference, belief, starts):
    return jax.vmap(
        lambda start: reference(belief.guidance, belief.clearance, PERCEPTION.required, start)
    )(starts)


def read(field, places: np.ndarray) -> np.ndarray:
    """Return the interpolated values at positions (N, 3)."""
    nodes = (places - np.asarray(field.origin, float)) / field.spacing
    sizes = np.array(field.values.shape[::-1])
    values = map_coordinates(
        np.asarray(field.values, float), nodes[:, ::-1].T, order=1, mode="nearest"
    )
    inside = ((nodes >= -0.5001) & (nodes <= sizes - 0.4999)).all(axis=1)
    return np.where(inside, values, float(field.outside))


def stepped(belief, place: np.ndarray, length: float) -> np.ndarray:
    """Take one step of the descent."""
    spacing = belief.guidance.spacing
    half = 0.5 * spacing * np.eye(3)
    ahead, behind = (read(belief.guidance, place + side * half) for side in (1.0, -1.0))
    slope = (ahead - behind) / spacing
    moves = [np.array(each) for each in np.ndindex(3, 3, 3)]
    moves = [each - 1.0 for each in moves if (each != 1).any()]
    moves = [each / np.linalg.norm(each) for each in moves]
    here, clear = read(belief.guidance, place[None])[0], read(belief.clearance, place[None])[0]

    def may(after: np.ndarray) -> bool:
        falls = read(belief.guidance, after[None])[0] < here
        return bool(falls and read(belief.clearance, after[None])[0] >= min(REQUIRED, clear))

    if np.linalg.norm(slope) > FLAT:
        after = place - length * slope / np.linalg.norm(slope)
        if may(after):
            return after
    others = [place + length * move for move in moves]
    others = [after for after in others if may(after)]
    costs = [read(belief.guidance, after[None])[0] for after in others]
    return others[int(np.argmin(costs))] if others else place


@pytest.fixture(scope="module")
def paths(known) -> tuple[np.ndarray, np.ndarray]:
    """Return 30 starts (30, 3) in the hall, some closer to walls than needed, and their paths."""
    starts = np.random.default_rng(1).uniform([0.4, 0.4, 0.4], [7.6, 3.6, 2.0], (30, 3))
    starts = starts.astype(np.float32)
    return starts, np.asarray(descend(PACE, known, jnp.asarray(starts)))


def test_the_reference_is_the_descent_in_numpy(known, paths) -> None:
    starts, found = paths
    moved = 0
    for start, path in zip(starts[:10], found, strict=False):
        before = start.astype(float)
        for after in path:
            expected = stepped(known, before, 1.8 * 0.05)
            # Where two directions are as good, rounding decides: what counts is the cost.
            costs = read(known.guidance, np.stack([after.astype(float), expected]))
            assert costs[0] == pytest.approx(costs[1], abs=2e-3)
            moved += np.linalg.norm(after - before) > 0.01
            before = after.astype(float)
    assert moved > 100


def test_the_reference_keeps_clear_and_the_cost_never_rises(known, paths) -> None:
    starts, found = paths
    arrived = 0
    for start, path in zip(starts, found, strict=True):
        places = np.concatenate([start[None], path]).astype(float)
        clear = read(known.clearance, places)
        assert (clear >= min(REQUIRED, clear[0]) - 1e-4).all()
        assert (np.diff(read(known.guidance, places)) <= 1e-4).all()
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
        # It moves at its speed or stands, and once it stands it stays.
        assert ((steps < 1e-6) | (np.abs(steps - 1.8 * 0.05) < 1e-4)).all()
        assert (np.diff((steps > 1e-6).astype(int)) <= 0).all()
        arrived += read(known.guidance, places[-1:])[0] < 0.2
    # From this side of the wall the way is longer than the reference.
    assert arrived > 5


@pytest.mark.parametrize("start", [(np.nan, 1.0, 1.0), (1.0, 1.0, np.inf), (-3.0, 1.0, 1.0)])
def test_nothing_moves_that_is_nowhere(start, known) -> None:
    starts = jnp.broadcast_to(jnp.asarray(start, jnp.float32), (30, 3))
    path = np.asarray(descend(PACE, known, starts))
    np.testing.assert_array_equal(path, np.broadcast_to(np.float32(start), path.shape))


# The plan and what the costs read


@eqx.filter_jit
def plan_of(controller, belief, observation):
    plan = controller.strategic_plan(belief, observation)
    return plan, controller.extend_belief(belief, observation, plan, jnp.asarray(0.1))


def test_the_plan_leads_to_the_best_heading_and_the_costs_read_it(known, controllers) -> None:
    nodes = known.attention.values.shape
    values = jnp.zeros(nodes).at[5].set(2.0).at[9, :, :, :8].set(3.0)
    belief = eqx.tree_at(
        lambda each: (each.attention.values, each.information.values), known, (values, values)
    )
    controller = controllers["two-layer"]
    at = ROBOT.at_pose(6.0, 1.6, 0.7, -1.2)
    plan, strategic = plan_of(controller, belief, at)
    # The path ends beyond the eighth node, where heading 5 of 16 is the best one.
    assert plan.reference[-1, 0] > 6.2
    assert float(plan.heading) == pytest.approx(5 * math.pi / 8, rel=1e-6)
    assert float(controller.follower_of(plan).heading) == float(plan.heading)
    np.testing.assert_array_equal(plan.best.values, values.max(axis=0))
    np.testing.assert_allclose(
        controller.path(plan.reference), np.asarray(plan.reference) * [1.0, 1.0, -1.0]
    )

    def price(cost, x: float, y: float, z: float, t: float) -> float:
        state = State(ROBOT.at_pose(x, y, 0.0, z), ROBOT)
        return float(cost.stage(state, jnp.zeros(4), jnp.asarray(t), strategic))

    # The third row is due 0.15 s after the plan was made, and it is 0.1 s old.
    x, y, z = (float(each) for each in plan.reference[2])
    assert price(StrategyReferenceCost(), x, y, -z, 0.05) == pytest.approx(0.0, abs=1e-9)
    away = price(StrategyReferenceCost(), x + 0.3, y - 0.2, -z + 0.5, 0.05)
    assert away == pytest.approx(0.09 + 0.04 + 0.25, rel=1e-4)
    assert price(PotentialCost(), 1.2, 2.8, -1.2, 0.0) == pytest.approx(-3.0)
    assert price(PotentialCost(), 6.0, 2.8, -1.2, 0.0) == pytest.approx(-2.0)
    # Without information the heading is kept.
    nothing = dataclasses.replace(known, attention=known.information)
    assert float(plan_of(controller, nothing, at)[0].heading) == pytest.approx(0.7, rel=1e-5)


step = eqx.filter_jit(VolumeInformativeMPPI.step)


def test_a_robot_that_is_lost_keeps_its_plan(known, controllers) -> None:
    controller = controllers["two-layer"]
    at, lost = ROBOT.at_pose(6.0, 1.6, 0.7, -1.2), jnp.full(13, jnp.nan, jnp.float32)
    _, state, _ = step(controller, controller.init(), at, known, key=jax.random.key(0))
    assert int(state.age) == 1
    due = state._replace(age=jnp.asarray(4, jnp.int32))
    control, after, info = step(controller, due, lost, known, key=jax.random.key(1))
    np.testing.assert_array_equal(after.plan.reference, state.plan.reference)
    assert int(after.age) == 5
    assert np.isfinite(control).all()
    assert not bool(info.is_finite)
    _, again, info = step(controller, after, at, known, key=jax.random.key(2))
    assert int(again.age) == 1
    assert bool(info.is_finite)


def test_what_the_architectures_differ_in(controllers) -> None:
    two_layer, parallel = (controllers[name] for name in ARCHITECTURES)
    assert isinstance(two_layer.mppi.proposal, BiasedProposal)
    assert two_layer.has_reference
    assert not isinstance(parallel.mppi.proposal, BiasedProposal)
    assert not parallel.has_reference
    assert parallel.follower_of(parallel.blank_plan()) is None
    names = [{name for name, _ in each.mppi.cost.terms()} for each in (two_layer, parallel)]
    assert names[0] - names[1] == {"StrategyReferenceCost"}
    assert names[1] - names[0] == {"PotentialCost"}
    # A slower robot has a slower reference.
    assert float(controller_of("two-layer", max_speed=0.7).reference.speed) == pytest.approx(0.7)


# The closed loop

NUMBERS: dict[str, Any] = {
    "strategy_period": 0.4,
    "bias_fraction": 0.25,
    "reference_speed": 1.3,
    "reference_weight": 0.5,
    "field_weight": 7.0,
    "guidance_weight": 3.0,
}


@every
def test_it_explores_the_hall_without_a_contact(architecture: str, controllers) -> None:
    given = scenario(target_coverage=0.9)
    run = jx.simulate(controllers[architecture], given, 400, key=jax.random.key(2))
    assert run.metrics.is_finished
    assert run.metrics.collisions == 0
    assert run.metrics.minimum_clearance > 0.0
    compiled = run_chunk._cached._cache_size()
    again = jx.simulate(controllers[architecture], given, 60, key=jax.random.key(2))
    first = np.asarray(run.recording.records.state)[:60]
    np.testing.assert_array_equal(again.recording.records.state, first)
    # Other numbers need no other program.
    other = jx.simulate(controller_of(architecture, **NUMBERS), given, 60, key=jax.random.key(2))
    assert not np.array_equal(other.recording.records.state, first)
    assert run_chunk._cached._cache_size() == compiled


# What is refused


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"strategy_period": 0.07}, "strategy_period is 0.07 s; accepted: a whole number of contr"),
        ({"max_speed": -1.0}, "max_speed is -1"),
    ],
)
def test_what_is_not_possible_is_refused(change: dict[str, Any], message: str) -> None:
    given = {"architecture": "two-layer", **change}
    with pytest.raises(ValueError, match=message):
        controller_of(**given)


def test_parts_must_go_together(controllers) -> None:
    two_layer = controllers["two-layer"]
    for reference, follower in ((PACE, None), (None, QuadrotorFollower()), (None, None)):
        with pytest.raises(ValueError, match="accepted: a BiasedProposal with both, or another"):
            VolumeInformativeMPPI(
                two_layer.mppi, PERCEPTION, room(column=20), reference=reference, follower=follower
            )
    with pytest.raises(ValueError, match="belief is None; accepted: a VolumeBelief"):
        two_layer.step(two_layer.init(), ROBOT.at_pose(1.0, 1.0, 0.0, -1.0), key=jax.random.key(0))
