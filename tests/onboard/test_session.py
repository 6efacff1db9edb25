"""A session: what a robot knows is kept, and after a restart it finds itself and goes on."""

import json
import shutil

import jax
import numpy as np
import pytest
from tests.onboard.conftest import ROBOT, blank, rooms, scenario_in

from jaxplore import OccupancyGrid, explorer
from jaxplore.localisation import Localiser, LoopCloser, Odometry
from jaxplore.onboard.finding import LOOKING
from jaxplore.onboard.localisation import compose
from jaxplore.onboard.options import Mode, PilotOptions
from jaxplore.onboard.pilot import Pilot
from jaxplore.onboard.session import FILE, PLACE, Kept, LastPlace, Session
from jaxplore.onboard.session_writer import SessionWriter
from jaxplore.onboard.simulated_robot import SimulatedRobot
from jaxplore.simulation import Localisation

pytestmark = pytest.mark.long

FACTS = {"resolution": 0.1}
ELSEWHERE = np.array([30.0, -12.0, 2.0])
"""Where the odometry begins anew after a restart."""


def unlike() -> OccupancyGrid:
    """The two rooms with furniture, so that none looks like the other or like itself turned."""
    values = np.array(rooms().probability)
    values[40:, 3:9] = values[34:, 56:] = values[:8, 44:50] = 1.0
    return OccupancyGrid(values, 0.1)


def make_robot(start=(1.0, 1.0, 0.3), **options) -> SimulatedRobot:
    """Return a robot in that world, of the program of the other tests."""
    return SimulatedRobot(scenario_in(unlike(), start), jax.random.key(2), **options)


def make_pilot(folder, *, is_internal=True, **options) -> Pilot:
    """Return a pilot with a session, of the program of `make_localised` or of `make_pilot`."""
    scenario = scenario_in(blank(), (0.0, 0.0, 0.0), goal=(0.0, 0.0))
    localiser = Localiser(Odometry(scale=0.1, turn_scale=0.1), memory=4.0, capacity=256)
    found = Localisation(localiser=localiser, closer=LoopCloser(tolerance=0.01))
    pilot = Pilot(
        *(scenario, explorer(ROBOT, horizon=30, num_samples=128), jax.random.key(5)),
        PilotOptions(latency=0.06, **options),
        localisation=found if is_internal else None,
        session=Session(folder, FACTS, {"resolution": 0.1}),
    )
    pilot.prepare()
    return pilot


def moved(by):
    return lambda now, measured: measured._replace(pose=compose(by, measured.pose))


def known_area(pilot) -> float:
    return float((np.asarray(pilot.belief.grid.probability) < 0.25).sum()) * 0.01


def error(pilot, robot) -> float:
    """Return the distance of the pose in the map from the true one, which its frame has [m]."""
    return float(np.hypot(*(pilot.pose - np.asarray(robot.state.robot)[:3])[:2]))


@pytest.fixture(scope="module")
def driven(tmp_path_factory, drive):
    """The first part of an exploration, and the folder that it has left."""
    folder, robot = tmp_path_factory.mktemp("session"), make_robot(delay=0.04, drift=0.05)
    pilot, seconds = make_pilot(folder), [0.0]
    writer = SessionWriter(pilot, print, lambda: seconds[0])
    drive(pilot, robot, 4.5)
    # A whole writing, and then places only: as after kill -9.
    seconds[0] = 30.0
    writer.write_when_due()
    drive(pilot, robot, 1.5)
    writer._running.result()
    area = known_area(pilot)
    former = (folder / FILE).read_bytes()
    seconds[0] = 31.5
    writer.write_when_due()
    writer._running.result()
    assert (folder / FILE).read_bytes() == former
    return folder, robot, area, robot.coverage


@pytest.fixture
def left(driven, tmp_path):
    """A copy of the folder."""
    return shutil.copytree(driven[0], tmp_path / "session")


@pytest.fixture(scope="module")
def resumed(driven, tmp_path_factory, drive, drive_until):
    """The second part, whose odometry begins anew elsewhere."""
    folder, robot, area, _ = driven
    kept = shutil.copytree(folder, tmp_path_factory.mktemp("second") / "session")
    # What a writing that was killed leaves, whose lock nobody holds.
    half = kept / ".jaxplore-0123456789ab.tmp"
    half.write_bytes((kept / FILE).read_bytes()[:1000])
    pilot = make_pilot(kept, done_after=2.0)
    before = known_area(pilot)
    first, _ = drive(pilot, robot, 0.1, moved(ELSEWHERE), 100.0)
    stood = np.asarray(robot.state.robot)[:2]
    until = lambda: not pilot.lost  # noqa: E731
    commands, _ = drive_until(until, pilot, robot, 10.0, moved(ELSEWHERE), 100.0)
    at, away = error(pilot, robot), float(np.hypot(*(np.asarray(robot.state.robot)[:2] - stood)))
    commands = [*first, *commands]
    last, _ = drive_until(lambda: pilot.finished, pilot, robot, 30.0, moved(ELSEWHERE), 100.0)
    pilot.session.write(pilot.snapshot())
    return pilot, robot, before, area, commands, at, away, last, half


def test_a_robot_stands_until_it_has_found_itself(resumed) -> None:
    _, _, _, _, commands, at, away, _, _ = resumed
    lost = [each for each in commands if each.reason.startswith(LOOKING)]
    assert len(lost) > 20
    assert not np.any([each.twist for each in lost])
    # It was on its way when the process died, and its watchdog stops it.
    assert away < 0.5
    assert at < 0.2
    assert "compares a place" in lost[-1].reason


def test_coverage_goes_on_from_where_it_was(resumed, driven) -> None:
    pilot, robot, before, area, _, _, _, last, _ = resumed
    # The last whole file counts, which is older than the drive.
    assert 5.0 < before <= area + 0.1
    assert robot.coverage > 0.97
    assert robot.num_contacts == 0
    assert last[-1].mode is Mode.DONE
    assert error(pilot, robot) < 0.2
    # As the log counts it, what was known before is there from the first command on.
    assert pilot.recording().records.coverage[0] > 0.5 * driven[3]


def test_nothing_is_mapped_twice(resumed) -> None:
    pilot, _, _, _, _, _, _, _, _ = resumed
    grid = pilot.belief.grid
    rows, columns = np.nonzero(grid.crop(grid.is_occupied))
    # The map begins at the first position, (1, 1) in the world.
    corner = np.asarray(grid.frame.origin)[:2] + pilot.offset
    places = corner + 0.1 * (np.stack([columns, rows], axis=1) + 0.5)
    world = np.asarray(unlike().is_occupied)
    near = np.zeros(len(places), bool)
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            at = np.floor(places / 0.1).astype(int)[:, ::-1] + [row, column]
            inside = ((at >= 0) & (at < world.shape)).all(axis=1)
            near[inside] |= world[tuple(at[inside].T)]
    assert near.mean() > 0.95


def test_what_a_killed_writing_has_left_is_removed_and_never_read(resumed) -> None:
    assert not resumed[-1].exists()


def test_the_pose_graph_goes_on(resumed, driven) -> None:
    pilot = resumed[0]
    known = pilot._mapper.known.own.place.known
    kept = Session(driven[0], FACTS, {}).kept.arrays
    number = int(kept["place/scans/number"])
    assert int(known.scans.number) > number
    np.testing.assert_array_equal(
        np.asarray(known.scans.ranges)[:number], kept["place/scans/ranges"][:number]
    )
    # The way between the two drives is an edge of its own, as exact as the pose that was found.
    spread = np.sqrt(np.asarray(known.scans.covariances)[number][0, 0])
    assert 0.001 < spread < 0.2


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"facts": {"resolution": 0.05}}, "was begun with resolution 0.05, and now it is 0.1"),
        ({"version": "9.9"}, "is of version '9.9' of jaxplore, format 1; accepted: '0.1.0'"),
        ({"format": 2}, "format 2; accepted: '0.1.0', format 1"),
        ({"home": [1.0]}, r"has \[1.0\] for its home; accepted: 2 numbers"),
        ({"offset": None}, "has None for its offset"),
        ({"facts": 3}, "header is damaged"),
    ],
)
def test_another_version_or_other_settings_are_one_line_and_change_nothing(
    left, change, said
) -> None:
    with np.load(left / FILE) as packed:
        arrays = dict(packed)
    header = {**json.loads(arrays["header"].tobytes()), **change}
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez(left / FILE, **arrays)
    before = (left / FILE).read_bytes()
    with pytest.raises(ValueError, match=said) as found:
        Session(left, FACTS, {})
    assert "\n" not in str(found.value)
    assert (left / FILE).read_bytes() == before


def test_half_a_file_and_other_arrays_are_refused(left) -> None:
    whole = (left / FILE).read_bytes()
    (left / FILE).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"is no session: .*; accepted: a folder that"):
        Session(left, FACTS, {})
    (left / FILE).write_bytes(whole)
    (left / PLACE).write_text('{"pose": [0, 0')
    with pytest.raises(ValueError, match="is no place"):
        Session(left, FACTS, {})
    (left / PLACE).unlink()
    for name, value, said in (
        ("known/map", np.zeros((4, 4), np.float32), r"has 'float32 \[4, 4\]' for 'map'"),
        ("known/map", None, "has nothing for 'map'|has 'nothing' for 'map'"),
        ("known/place/scans/number", np.int32(10**9), "is damaged"),
    ):
        with np.load(left / FILE) as packed:
            arrays = dict(packed)
        arrays[name] = value
        np.savez(left / FILE, **{key: each for key, each in arrays.items() if each is not None})
        with pytest.raises(ValueError, match=said):
            make_pilot(left)
        (left / FILE).write_bytes(whole)


def test_a_robot_in_another_building_does_not_drive_and_says_why(left, drive) -> None:
    world = np.zeros((60, 60), np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 1.0, 1.0, 1.0, 1.0
    # Round columns stand where the rooms of the session have straight walls.
    row, column = np.mgrid[:60, :60]
    for at in ((18, 18), (18, 36), (34, 27), (44, 14), (46, 44)):
        world[np.hypot(row - at[0], column - at[1]) < 4.5] = 1.0
    scenario = scenario_in(OccupancyGrid(world, 0.1), (2.7, 2.4, 0.3))
    robot = SimulatedRobot(scenario, jax.random.key(2))
    pilot = make_pilot(left)
    commands, states = drive(pilot, robot, 6.0)
    assert not np.any([each.twist for each in commands])
    np.testing.assert_allclose(states[-1][:2], [2.7, 2.4], atol=1e-6)
    assert commands[-1].mode in (Mode.WAITING, Mode.BRAKING)
    assert "the robot waits to be moved" in commands[-1].reason
    # Nothing that this robot sees is written.
    assert pilot.snapshot() is None
    assert pilot.last_place() is None
    before = (left / FILE).read_bytes()
    writer = SessionWriter(pilot, told := [].append)
    writer.ask()
    writer.write_when_due()
    writer.end()
    assert (left / FILE).read_bytes() == before
    assert told is not None


def test_a_robot_that_is_told_its_pose_takes_it_only_where_scans_fit(driven, left, drive) -> None:
    (left / PLACE).unlink()
    robot = make_robot(start=(2.0, 1.0, 0.3))
    pilot = make_pilot(left)
    drive(pilot, robot, 0.5)
    # Far from where it is.
    pilot.tell_pose(np.array([1.0, 3.0, -2.0]))
    for _ in range(10):
        commands, _ = drive(pilot, robot, 0.1)
        # It may find itself where it is, but does not drive where it was told to be.
        assert pilot.lost or error(pilot, robot) < 0.2
        assert not (pilot.lost and np.any([each.twist for each in commands[1:]]))
    pilot.tell_pose(np.array([2.2, 0.9, 0.2]))
    drive(pilot, robot, 1.5)
    assert not pilot.lost
    assert error(pilot, robot) < 0.2


def test_a_place_that_is_not_mapped_yet_is_no_other_one_that_looks_alike(left, drive) -> None:
    """Killed in a room that no whole file has, the robot is not in the other room."""
    kept = Session(left, FACTS, {}).kept
    values = np.array(kept.arrays["map"])
    robot = SimulatedRobot(scenario_in(rooms(), (4.9, 2.1, 0.3)), jax.random.key(2))
    pilot = make_pilot(left)
    # Everything behind the door is unknown again, and the robot was seen there last.
    grid = pilot.belief.grid
    door = round((3.1 - float(grid.frame.origin[0]) - pilot.offset[0]) / 0.1)
    values[:, door:] = np.where(values[:, door:] == 1.0, 1.0, 0.5)
    pilot.session.write(Kept({**kept.arrays, "map": values}, kept.offset, kept.home))
    there = np.array([4.9, 2.1, 0.3]) - np.append(pilot.offset, 0.0)
    pilot.session.write_place(LastPlace(there, np.zeros(3)))
    lost = make_pilot(left)
    commands, _ = drive(lost, robot, 3.0, moved(ELSEWHERE))
    assert not np.any([each.twist for each in commands])
    assert lost.lost.startswith(LOOKING)
    # An odometry that has gone on says that it is there.
    found = make_pilot(left)
    drive(found, robot, 3.0)
    assert not found.lost
    assert error(found, robot) < 0.2


def test_a_pose_that_is_given_goes_on_in_the_map_of_the_session(tmp_path, drive) -> None:
    """Without a localisation of its own the robot finds once where the poses are in its map."""
    robot = make_robot(delay=0.04)
    first = make_pilot(tmp_path, is_internal=False)
    drive(first, robot, 5.0)
    first.session.write(first.snapshot())
    first.session.write_place(first.last_place())
    area = known_area(first)
    again = make_pilot(tmp_path, is_internal=False)
    commands, _ = drive(again, robot, 5.0, moved(ELSEWHERE))
    assert commands[10].reason.startswith(LOOKING)
    assert not again.lost
    assert error(again, robot) < 0.1
    assert known_area(again) >= area - 0.1
