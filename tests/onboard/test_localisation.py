"""A robot that finds its own pose: drifting odometry, scans, and closed loops."""

import jax
import numpy as np
import pytest

from jaxplore.localisation import LoopCloser
from jaxplore.onboard import localisation, steps
from jaxplore.onboard.localisation import MapPoses, compose
from jaxplore.onboard.odometry import PoseHistory
from jaxplore.onboard.options import Mode
from jaxplore.robot import localisation as robot_localisation
from jaxplore.sensing.beams import Scan
from jaxplore.tasks.exploration.pilot import build_pilot, make_node_settings

pytestmark = pytest.mark.long

LATENCY, DRIFT, MAX_JUMP = 0.06, 0.08, 0.05
COMPILED = "/jax/core/compile/backend_compile_duration"


@pytest.fixture(scope="module")
def drive_localised(make_localised, make_robot, drive_until):
    """Return a function that drives with a drifting odometry, and tells what it saw."""

    def run(seconds, change=lambda now, measured: measured, **options):
        pilot = make_localised(LoopCloser(tolerance=0.01), latency=LATENCY, **options)
        pilot.prepare()
        robot = make_robot(delay=0.04, drift=DRIFT)
        robot.prepare()
        poses, corrections = [], []

        def seen(now, measured):
            # Those of the measurement before, after its scan was mapped.
            if pilot.pose is not None:
                poses.append(pilot.pose)
                corrections.append(pilot.correction)
            return change(now, measured)

        truth = [np.asarray(robot.state.robot)]
        commands, states = drive_until(lambda: pilot.finished, pilot, robot, seconds, seen)
        truth = np.concatenate([truth, states])[: len(poses)]
        return pilot, robot, commands, np.array(poses), truth, np.array(corrections)

    return run


@pytest.fixture(scope="module")
def explored(drive_localised):
    """One drive until nothing is left to explore, with what was compiled and remapped in it."""
    remapped, compiled = [], []

    def count(event, seconds, **_):
        if event == COMPILED:
            compiled.append(seconds)

    whole = robot_localisation.close_loops

    def revised(*given):
        known, belief = whole(*given)
        remapped.append(belief is not given[4])
        return known, belief

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robot_localisation, "close_loops", revised)
        found = []

        def change(now, measured):
            if not found:
                # Everything was prepared by now.
                found.append(now)
                remapped.clear()
                jax.monitoring.register_event_duration_secs_listener(count)
            return measured

        try:
            drive = drive_localised(25.0, change, max_jump=MAX_JUMP)
        finally:
            jax.monitoring.unregister_event_duration_listener(count)
    return drive, sum(remapped), len(compiled)


def distances(poses, truth) -> np.ndarray:
    return np.hypot(*(poses - truth[:, :3])[:, :2].T)


def test_the_pose_in_the_map_is_far_better_than_the_odometry(explored) -> None:
    (pilot, robot, commands, poses, truth, corrections), _, _ = explored
    # What the correction takes away is the drift of the odometry.
    reckoned = np.array([
        compose(localisation.inverse(each), pose)
        for each, pose in zip(corrections, poses, strict=True)
    ])  # fmt: skip
    odometry, known = distances(reckoned, truth), distances(poses, truth)
    assert odometry.max() > 0.35
    assert known.max() < 0.15
    assert np.median(known) < 0.35 * np.median(odometry)
    assert robot.coverage > 0.95
    assert robot.num_contacts == 0
    assert commands[-1].reason == "no place that is worth a visit is reachable"
    np.testing.assert_allclose(pilot.recording(in_odometry=True).positions[-1], truth[-1, :2],
                               atol=0.2)  # fmt: skip


def test_loops_move_the_map_and_nothing_compiles_while_driving(explored) -> None:
    _, remapped, compiled = explored
    assert remapped >= 1
    assert compiled == 0


def test_a_correction_is_no_jump_of_the_robot(explored) -> None:
    (_, _, commands, _, _, corrections), _, _ = explored
    # Together they are more than a pose may jump.
    assert np.hypot(*np.ptp(corrections[:, :2], axis=0)) > 4.0 * MAX_JUMP
    assert {each.mode for each in commands} == {Mode.DRIVING, Mode.DONE}


def test_the_same_data_give_the_same_commands(explored, drive_localised) -> None:
    (_, _, commands, poses, _, _), _, _ = explored
    programs = (steps.map_scan, steps.update_fields, steps.plan)
    before = [each._cached._cache_size() for each in programs]
    again = drive_localised(2.0, max_jump=MAX_JUMP)
    for one, other in zip(again[2], commands, strict=False):
        np.testing.assert_array_equal(one.twist, other.twist)
    np.testing.assert_array_equal(again[3], poses[: len(again[3])])
    assert [each._cached._cache_size() for each in programs] == before


def test_an_odometry_that_jumps_brakes_the_robot_and_moves_nothing_in_the_map(
    drive_localised,
) -> None:
    def jump(now, measured):
        far = np.array([2.0, -1.0, 1.2]) * (now >= 1.0)
        return measured._replace(pose=compose(far, measured.pose))

    pilot, robot, commands, poses, truth, _ = drive_localised(3.5, jump)
    assert commands[50].reason.startswith("the pose jumped by ")
    assert commands[50].mode is Mode.BRAKING
    assert commands[-1].mode is Mode.DRIVING
    assert distances(poses, truth).max() < 0.15
    assert robot.num_contacts == 0
    # What other nodes look up has the jump.
    assert np.hypot(*pilot.correction[:2]) > 1.0


def test_scans_that_contradict_the_map_do_not_move_the_pose(drive_localised) -> None:
    def misplace(now, measured):
        if not 1.2 <= now < 2.2 or measured.scan is None:
            return measured
        near = np.full_like(np.asarray(measured.scan.ranges), 0.6) + 1e-3 * np.sin(10.0 * now)
        return measured._replace(scan=Scan(near.astype(np.float32), np.ones(len(near), bool)))

    _, robot, commands, poses, truth, _ = drive_localised(3.5, misplace)
    reasons = [each.reason for each in commands]
    assert any(each.startswith("the scan does not fit") for each in reasons)
    assert commands[-1].mode is Mode.DRIVING
    assert distances(poses, truth).max() < 0.15
    assert robot.num_contacts == 0


def test_data_that_are_old_or_frozen_brake_and_those_that_are_not_finite_pass_by(
    drive_localised,
) -> None:
    kept = {}

    def spoil(now, measured):
        if 1.0 <= now < 1.8:
            measured = measured._replace(scan=None)
        if 3.5 <= now < 4.3:
            return measured._replace(pose=kept["pose"], twist=np.array([0.5, 0.0, 0.0]))
        if 6.0 <= now < 6.3:
            return measured._replace(pose=np.array([np.nan, 0.0, 0.0]))
        kept["pose"] = measured.pose
        return measured

    _, robot, commands, poses, truth, _ = drive_localised(9.0, spoil)
    reasons = [each.reason for each in commands if each.mode is Mode.BRAKING]
    for begin in ("the scan is 0.3", "the pose does not change", "the pose jumped"):
        assert any(each.startswith(begin) for each in reasons)
    assert np.isfinite(poses[-1]).all()
    assert distances(poses[-1:], truth[-1:])[0] < 0.2
    assert commands[-1].mode in (Mode.DRIVING, Mode.DONE)
    assert np.isfinite([each.twist for each in commands]).all()
    assert robot.num_contacts == 0


def test_without_a_localisation_the_pose_is_that_of_the_odometry(make_pilot) -> None:
    pilot = make_pilot()
    far = np.array([500_000.3, 4_649_776.2, 0.3])
    for time, pose in ((0.0, far), (0.1, far + np.array([9.0, 0.0, 0.0]))):
        pilot.add_odometry(time, pose, np.zeros(3))
        np.testing.assert_array_equal(pilot.pose, pose)
    np.testing.assert_array_equal(pilot.correction, np.zeros(3))


def test_the_transform_to_the_map_is_exact_far_from_the_origin() -> None:
    poses = MapPoses(PoseHistory(), 0.1, is_internal=True)
    far = np.array([500_000.3, 4_649_776.2, 0.3])
    assert poses.add(0.0, far, np.array([1.0, 0.0, 0.0])) is None
    assert poses.add(0.1, far + 0.05, np.zeros(3)) is None
    np.testing.assert_allclose(poses.offset, [500_000.3, 4_649_776.2], atol=1e-6)
    correction = np.array([0.2, -0.1, 0.05])
    transform = poses.in_map(np.zeros(3), correction)
    placed = compose(transform, far)
    np.testing.assert_allclose(placed, poses.in_map(far, correction), atol=1e-6)
    expected = far + correction
    np.testing.assert_allclose(placed, expected, atol=1e-6)


def test_an_odometry_that_starts_anew_goes_on_from_where_its_velocity_led() -> None:
    poses = MapPoses(PoseHistory(), 0.1, is_internal=True)
    poses.add(0.0, np.array([3.0, 2.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    assert poses.add(0.1, np.zeros(3), np.zeros(3)) == "the pose jumped by 3.69 m and 0.00 rad"
    np.testing.assert_allclose(poses.in_map(np.zeros(3), np.zeros(3)), [3.1, 2.0, 0.0], atol=1e-9)
    # One that was not finite for a while, and is back where it was, has not jumped.
    assert poses.add(0.2, np.full(3, np.nan), None) is not None
    assert poses.add(0.3, np.array([0.1, 0.0, 0.0]), np.zeros(3)) is not None
    np.testing.assert_allclose(
        poses.in_map(np.array([0.1, 0.0, 0.0]), np.zeros(3)), [3.2, 2.0, 0.0], atol=1e-9
    )


@pytest.mark.parametrize(
    ("entries", "text"),
    [
        ({"node": {"pose": "gps"}}, "pose"),
        (
            {"node": {"pose": "internal", "mode": "goal"}},
            "node.pose is 'internal' with node.mode goal; accepted: external",
        ),
        ({"node": {"pose": "internal"}, "localisation": {"memory": -1.0}}, "localisation.memory"),
    ],
)
def test_settings_that_make_no_sense_are_refused_in_a_line(entries, text) -> None:
    with pytest.raises(ValueError, match=text) as error:
        make_node_settings(entries)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "value", "accepted"),
    [("uncertainty_weight", 2.0, "0"), ("most_uncertainty", 0.5, "none")],
)
def test_plans_that_know_the_uncertainty_are_refused(name, value, accepted) -> None:
    given = make_node_settings({"node": {"pose": "internal"}, "localisation": {name: value}})
    with pytest.raises(ValueError, match=f"localisation.{name} is {value:g}.*: {accepted}"):
        build_pilot(*given)


def test_a_localisation_is_that_of_the_settings_and_external_poses_have_none() -> None:
    entries = {"localisation": {"memory": 7.0}}
    settings, _ = make_node_settings(entries)
    assert settings.localisation is None
    settings, _ = make_node_settings({"node": {"pose": "internal"}})
    assert settings.localisation is not None
    settings, node = make_node_settings(
        entries | {"node": {"pose": "internal", "map_size": 6.0}, "lidar": {"num_beams": 60}}
    )
    pilot = build_pilot(settings, node)
    assert pilot.scenario.localisation is None
    np.testing.assert_array_equal(pilot.correction, np.zeros(3))
    assert float(pilot._mapper._robot.localisation.localiser.memory) == 7.0
    # A node expects people, so its guard slows it down where somebody can be hidden.
    assert pilot.guard.occlusion is not None
    assert float(pilot.guard.occlusion.walker_speed) == pytest.approx(settings.people.max_speed)
