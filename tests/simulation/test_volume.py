"""A quadrotor explores a volume in the closed loop, and what the scenario says of it."""

import dataclasses
import json
import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import ImageColor
from tests.kinds import CAMERA, QUADROTOR, SIDE, volume, volume_controller

import jaxplore as jx
from jaxplore.costs import (
    AttitudeCost,
    BlindFlightCost,
    ObstacleCost,
    VolumeGuidanceCost,
    VolumeInformationCost,
)
from jaxplore.dynamics.quadrotor import attitude_upwards, position_upwards
from jaxplore.maps.generators.volumes import START
from jaxplore.report.drawing.colours import TARGET
from jaxplore.report.volume.recording import PALE, TRAIL
from jaxplore.simulation.loop import run_chunk

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def controller():
    return volume_controller()


@pytest.fixture(scope="module")
def run(controller):
    return jx.simulate(controller, volume(), 500, key=jax.random.key(0))


def test_it_explores_a_room_without_a_contact(run) -> None:
    metrics = run.metrics
    assert metrics.is_finished
    assert metrics.coverage >= 0.95
    assert metrics.collisions == 0
    assert metrics.minimum_clearance > 0.0
    # The record of a step has what was known at its beginning, and the run ends with that step.
    assert 0.0 < metrics.time_to["50"] < metrics.time_to["95"]
    assert metrics.time_to["95"] == pytest.approx(metrics.finished_at - 0.05, abs=1e-6)
    assert metrics.time_to["99"] is None
    assert metrics.volume == pytest.approx(38 * 18 * 10 * SIDE**3 - 7 * 10 * SIDE**3, rel=1e-6)
    # Hardly anything is taken to be free that is not.
    recording = run.recording
    wrong = (recording.belief == 1) & recording.world
    assert wrong.mean() < 0.002


def test_targets_are_drawn_filled_until_they_are_found(run, tmp_path) -> None:
    recording, targets = run.recording, np.array([[1.0, 1.0, 1.0], [7.0, 3.0, 1.5]])
    frames = tuple(
        dataclasses.replace(each, is_found=np.array([each.step > 0, False]))
        for each in recording.frames
    )
    search = dataclasses.replace(recording, targets=targets, frames=frames)
    purple = [
        (np.asarray(search.frame_image(each)) == np.array(TARGET)).all(axis=-1).sum()
        for each in (frames[0], frames[-1])
    ]
    assert purple[0] > purple[1] > 50
    figure = search.figures()["volume"]()
    figure.savefig(tmp_path / "volume.png")
    (legend,) = [each.get_legend() for each in figure.axes]
    assert [each.get_text() for each in legend.get_texts()] == ["target", "target found"]


def test_equal_seeds_give_equal_runs_and_other_rooms_do_not_recompile(run, controller) -> None:
    before = run_chunk._cached._cache_size()
    again = jx.simulate(controller, volume(), 500, key=jax.random.key(0))
    np.testing.assert_array_equal(again.recording.records.state, run.recording.records.state)
    other = jx.simulate(
        controller,
        volume(False, (4.0, 2.0, 1.0, -2.0), target_coverage=0.6),
        100,
        key=jax.random.key(1),
    )
    assert other.metrics.coverage >= 0.6
    assert run_chunk._cached._cache_size() == before


def test_walls_that_appear_are_solid_and_seen() -> None:
    fallen = np.zeros((12, 20, 40), bool)
    fallen[1:-1, 1:-1, 20] = True  # x from 4.0 to 4.2 m
    faults = jx.Faults(walls=fallen, walls_from=1.0)
    given = volume(False, (2.0, 2.0, 1.2, 0.0)).with_disturbances([faults])
    state, _ = given.init(None)
    moment, info = _moment(given)
    look = eqx.filter_jit(lambda now: given.perceive(state, now, jax.random.key(0))[0].belief)
    # Before the place of the wall, and so fast that the next step would touch it.
    ahead = state.robot.at[0].set(3.6).at[3].set(3.0)
    for step, is_there in ((0, False), (18, False), (20, True)):
        time = jnp.asarray(step * 0.05, jnp.float32)
        now = moment._replace(step=jnp.asarray(step, jnp.int32), time=time)
        seen = look(now).grid
        # Away from the floor and the ceiling, which may have readings in the voxels beside them.
        assert np.asarray(seen.is_occupied)[4:9, 6:14, 20].any() == is_there
        assert np.asarray(seen.is_free)[4:9, 6:14, 22:].any() != is_there
        flying = state._replace(robot=ahead)
        after, record = given.advance(flying, QUADROTOR.default_control, now, info)
        assert bool(record.is_collision) == is_there
        assert float(after.robot[0]) == pytest.approx(3.6 if is_there else 3.75, abs=1e-3)
        assert float(record.clearance) == pytest.approx(0.1, abs=1e-3) or not is_there


def test_what_brings_nothing_new_is_given_up(controller) -> None:
    given = volume(False, target_coverage=1.0, give_up_after=0.5)
    done = jx.simulate(controller, given, 500, key=jax.random.key(0))
    assert not done.metrics.is_finished
    assert done.metrics.given_up_at == pytest.approx(done.metrics.duration)
    # By hand: the last rise of at least 0.1 % was half a second before.
    best, last = done.recording.initial_coverage, 0
    for step, share in enumerate(np.asarray(done.recording.records.coverage)):
        if share >= np.float32(best) + np.float32(1e-3):
            best, last = share, step
    assert done.metrics.num_steps - 1 - last == 10
    assert done.metrics.num_steps < 500


def test_its_folder_has_pictures_and_is_read_again(run, tmp_path: Path) -> None:
    run.save(tmp_path / "run")
    names = {each.name for each in (tmp_path / "run").iterdir()}
    assert names == {
        *("metrics.json", "arrays.npz", "state.npz", "exploration.gif", "turntable.gif"),
        *("volume.png", "slices.png", "coverage.png"),
    }
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["collisions"] == 0
    loaded = jx.Run.load(tmp_path / "run")
    assert loaded.metrics == run.metrics
    with np.load(tmp_path / "run" / "arrays.npz", allow_pickle=False) as arrays:
        np.testing.assert_allclose(arrays["positions"][0], [1.2, 2.0, 1.2], atol=1e-6)
        assert arrays["belief"].shape == (12, 20, 40)
    frame = run.recording.frames[-1]
    picture = run.recording.frame_image(frame, scale=0.5)
    assert picture.width == 320
    # The level slice and the upright one are slices of what was known.
    assert set(np.unique(frame.level)) <= {0, 1, 2}
    assert frame.level.shape == (20, 40)
    assert frame.upright.shape == (12, 40)
    # The voxels of the last frame are those of the map at the end.
    np.testing.assert_array_equal(frame.find_occupied((12, 20, 40)), run.recording.belief == 2)
    assert frame.plan.shape == (21, 3)
    np.testing.assert_allclose(frame.plan[0], run.recording.positions[-1], atol=0.3)


def test_a_trail_is_pale_in_a_slice_that_it_is_not_near(run, monkeypatch) -> None:
    recording, frame = run.recording, run.recording.frames[-1]
    colours = [ImageColor.getrgb(each) for each in (TRAIL, PALE)]

    def counts() -> list[int]:
        picture = np.asarray(recording.frame_image(frame))
        level = picture[: picture.shape[1] * frame.level.shape[0] // frame.level.shape[1]]
        return [int((level == colour).all(axis=-1).sum()) for colour in colours]

    near, pale = counts()
    assert near > 0 == pale
    # At the time of the frame the robot is 2 m higher than at all times before it.
    positions = recording.positions.copy()
    positions[: frame.step, 2] -= 2.0
    monkeypatch.setattr(type(recording), "positions", property(lambda _: positions))
    beyond, pale = counts()
    assert beyond < near
    assert pale > 0


def test_a_replay_shows_its_voxels_in_space(run) -> None:
    from jaxplore.tasks.volume.scene import VolumeScene
    from jaxplore.view.replay import Replay

    replay = Replay(run.recording)
    try:
        scene = replay._display._scene
        assert isinstance(scene, VolumeScene)
        replay._slider.value = float(run.recording.time[-1])
        replay.tick(0.0)
        points = np.asarray(scene._nodes["voxels"].points)
        # What is drawn are the middles of occupied voxels below the ceiling.
        found = np.argwhere(run.recording.belief[:-2] == 2)
        np.testing.assert_allclose(points, (found[:, ::-1] + 0.5) * SIDE, atol=1e-5)
        here = run.recording.positions[-1]
        np.testing.assert_allclose(scene._nodes["robot"].position, here, atol=1e-5)
        pieces = np.asarray(scene._nodes["trail"].points)
        np.testing.assert_allclose(pieces[0, 0], [1.2, 2.0, 1.2], atol=1e-5)
        np.testing.assert_allclose(pieces[-1, 1], here, atol=1e-5)
        scene.show("voxels", is_shown=False)
        assert not scene._nodes["voxels"].visible
        (plot,) = replay._display.history.plots()
        assert plot.names == ("coverage",)
        assert plot.rows[-1, 1] == pytest.approx(run.metrics.coverage, abs=1e-6)
        scene.clear()
        assert not scene._nodes
    finally:
        replay.close()


def test_the_clearance_is_the_distance_to_the_nearest_cube() -> None:
    given = volume()
    clearance = eqx.filter_jit(given.clearance)
    for x, y, z, wanted in (
        (1.2, 2.0, 1.2, 0.7),  # to the wall at x = 0.2 m
        (2.5, 1.0, 1.2, 0.2),  # to the half wall at x = 3.0 m
        (3.1, 2.0, 1.2, 0.1),  # to its end at y = 1.6 m
        (3.4, 2.0, 1.2, math.hypot(0.2, 0.4) - 0.3),  # to its edge
        (2.0, 2.0, 0.4, -0.1),  # in contact with the floor
    ):
        state = QUADROTOR.at_pose(x, y, 0.0, -z)
        assert float(clearance(state)) == pytest.approx(wanted, abs=1e-5)


def test_a_contact_stops_the_robot() -> None:
    given = volume(False, (0.8, 2.0, 1.2, math.pi))
    state, _ = given.init(None)
    fast = state.robot.at[3].set(-3.0)
    moment = _moment(given)
    after, record = given.advance(
        state._replace(robot=fast.at[0].set(0.6)), QUADROTOR.default_control, *moment
    )
    assert bool(record.is_collision)
    np.testing.assert_allclose(after.robot[:3], [0.6, 2.0, -1.2], atol=1e-6)
    np.testing.assert_array_equal(after.robot[3:6], 0.0)
    lost = state._replace(robot=state.robot.at[3].set(jnp.nan))
    after, record = given.advance(lost, QUADROTOR.default_control, *moment)
    assert not bool(record.is_collision)


def _moment(given):
    from jaxplore.control.base import Info
    from jaxplore.simulation.state import Moment

    nothing, no = jnp.zeros(()), jnp.array(False)
    info = Info(jnp.zeros((1, 4)), nothing[None], nothing[None], nothing, no)
    return Moment(jnp.zeros((), jnp.int32), nothing, given.start, no, no), info


def test_attitudes_turn_the_body_with_z_up() -> None:
    level = np.asarray(attitude_upwards(QUADROTOR.at_pose(0.0, 0.0, 0.7)))
    cos, sin = math.cos(0.7), math.sin(0.7)
    np.testing.assert_allclose(level, [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]], atol=1e-6)
    # A positive pitch of an FRD body lifts the nose.
    half = 0.15
    up = jnp.zeros(13).at[6].set(math.cos(half)).at[8].set(math.sin(half))
    nose = np.asarray(attitude_upwards(up))[:, 0]
    np.testing.assert_allclose(nose, [math.cos(0.3), 0.0, math.sin(0.3)], atol=1e-6)
    above = position_upwards(QUADROTOR.at_pose(1.0, 2.0, 0.0, -3.0))
    np.testing.assert_allclose(above, [1.0, 2.0, 3.0])


def test_costs_are_what_they_say() -> None:
    given = volume(False)
    _, belief = given.init(None)
    belief = eqx.tree_at(
        lambda each: (each.clearance.values, each.guidance.values, each.attention.values),
        belief,
        (
            jnp.full(belief.clearance.values.shape, 0.4),
            jnp.full(belief.guidance.values.shape, -3.0),
            jnp.full(belief.attention.values.shape, 7.0),
        ),
    )
    values = QUADROTOR.at_pose(2.0, 2.0, 0.5, -1.2)
    sin, cos = math.sin(0.5), math.cos(0.5)
    # 1 m/s backwards and 2 m/s to the left of the heading.
    values = values.at[3].set(-cos - 2.0 * sin).at[4].set(-sin + 2.0 * cos).at[10].set(2.0)
    state = jx.State(values, QUADROTOR)

    def price(cost) -> float:
        return float(cost.stage(state, jnp.zeros(4), jnp.zeros(()), belief))

    assert price(VolumeGuidanceCost()) == pytest.approx(-3.0)
    # What differs from the place of the robot by more than the reach is behind a wall.
    rising = jnp.linspace(0.0, 50.0, belief.guidance.values.shape[2]) * jnp.ones(
        belief.guidance.values.shape
    )
    belief = eqx.tree_at(
        lambda each: (each.guidance.values, each.position),
        belief,
        (rising, jnp.asarray([2.0, 2.0, 1.2])),
    )
    here = price(VolumeGuidanceCost())
    for x, change in ((5.8, 5.0), (0.4, -5.0)):
        far = jx.State(values.at[0].set(x), QUADROTOR)
        cost = VolumeGuidanceCost(5.0).stage(far, jnp.zeros(4), jnp.zeros(()), belief)
        assert float(cost) == pytest.approx(here + change, abs=1e-4)
    assert price(VolumeInformationCost()) == pytest.approx(-7.0)
    assert price(BlindFlightCost(0.5)) == pytest.approx(1.0 + 0.5 * 4.0, rel=1e-5)
    assert price(AttitudeCost(0.1)) == pytest.approx(0.1 * 4.0)
    near = ObstacleCost(0.8, collision=3.0, margin=0.2, reaction_time=0.0)
    assert price(near) == pytest.approx(0.5**2 + 3.0 * (0.1 / 0.05) ** 2, rel=1e-4)


@pytest.mark.parametrize("kind", ["forest", "warehouse", "office", "maze", "cave"])
def test_a_volume_is_drawn_from_its_seed(kind: str) -> None:
    first, again, other = (jx.generate_volume(kind, seed, resolution=0.2) for seed in (3, 3, 4))
    solid = np.asarray(first.is_occupied)
    np.testing.assert_array_equal(solid, again.is_occupied)
    assert (solid != np.asarray(other.is_occupied)).mean() > 0.01
    assert solid[[0, -1]].all()
    assert solid[:, [0, -1]].all()
    assert solid[:, :, [0, -1]].all()
    assert 0.02 < solid[1:-1, 1:-1, 1:-1].mean() < (0.7 if kind == "cave" else 0.4)
    # A quadrotor fits at the start, and nearly all of the free space can be seen from where it
    # gets.
    given = jx.VolumeScenario(first, QUADROTOR, CAMERA, (*START, 0.0))
    assert np.asarray(given.observable).sum() > 0.95 * (~solid).sum()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"start": (9.0, 2.0, 1.0, 0.0)},
            r"start is \(9, 2, 1\), off the volume; accepted: x 0 to 8",
        ),
        ({"start": (0.3, 2.0, 1.0, 0.0)}, r"start is \(0.3, 2, 1\), within 0.3 m of a solid voxel"),
        ({"start": (1.0, 2.0)}, r"start is \(1.0, 2.0\); accepted: 4 finite"),
        ({"sensing_rate": 7.0}, "sensing_rate is 7"),
        ({"give_up_after": 0.0}, "give_up_after is 0"),
    ],
)
def test_what_is_not_possible_is_refused(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        volume(**change)


def test_faults_that_cannot_happen_in_a_volume_are_refused() -> None:
    flat = jx.Faults(walls=np.zeros((20, 40), bool))
    for faults, message in (
        (flat, r"walls has shape \(20, 40\); accepted: the world's, \(12, 20, 40\)"),
        (jx.Faults(carried_at=1.0), "faults has carried_at in a volume; accepted: faults without"),
    ):
        with pytest.raises(ValueError, match=message):
            volume().with_disturbances([faults])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: jx.generate_volume("forest", size=(2.0, 9.0, 3.0)), r"size is .*at least \(5, 5"),
        (lambda: jx.VoxelGrid(np.zeros((3, 3)), 0.1), "log_odds has shape"),
        (lambda: jx.VoxelGrid.solid(np.zeros((2, 2, 2)), 0.1), "mask has type float64"),
        (lambda: jx.VoxelGrid.unknown((1.0, 0.0, 1.0), 0.1), "size is"),
    ],
)
def test_volumes_that_are_none_are_refused(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
