"""A robot that knows its map: it finds itself, and drives to goals."""

import jax
import numpy as np
import pytest
from tests.onboard.conftest import LIDAR, ROBOT
from tests.onboard.test_session import error, make_robot, moved, unlike

from jaxplore import Perception, explorer
from jaxplore.localisation import Odometry, ParticleFilter, ParticleLocaliser
from jaxplore.onboard.finding import LOOKING
from jaxplore.onboard.options import Mode, PilotOptions
from jaxplore.onboard.pilot import Pilot
from jaxplore.parts import KeepOut
from jaxplore.simulation import Localisation
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.tasks.exploration.pilot import build_pilot, make_node_settings

pytestmark = pytest.mark.long

ELSEWHERE = np.array([-7.0, 40.0, -1.0])
AREA = [(1.0, 2.6), (2.4, 2.6), (2.4, 4.0), (1.0, 4.0)]
"""Where the robot must not be, in the frame of the map."""


@pytest.fixture(scope="module")
def driven(drive, drive_until):
    """A drive to a goal in the other room."""
    world, start = unlike(), (2.0, 1.0, 0.0)
    keep_out = KeepOut([AREA]).unplaced()
    perception = Perception(
        LIDAR, 0.1, 0.2, num_directions=16, margin=0.05, goal=start[:2], parts=[keep_out]
    )
    scenario = ExplorationScenario(
        world, ROBOT, LIDAR, start, perception=perception, prior=world, goal=start[:2]
    )
    filter = ParticleFilter(Odometry(scale=0.1, turn_scale=0.1))
    pilot = Pilot(
        *(scenario, explorer(ROBOT, horizon=30, num_samples=128), jax.random.key(5)),
        PilotOptions(latency=0.06, done_after=60.0),
        localisation=Localisation(localiser=ParticleLocaliser(filter)),
        is_map_known=True,
    )
    pilot.prepare()
    robot, errors = make_robot(delay=0.04, drift=0.05), []

    def seen(now, measured):
        if pilot.pose is not None and not pilot.lost:
            errors.append(error(pilot, robot))
        return moved(ELSEWHERE)(now, measured)

    first, _ = drive_until(lambda: not pilot.lost, pilot, robot, 5.0, seen)
    pilot.task.go_to(pilot.time, np.array([5.0, 3.0]))
    there, states = drive_until(lambda: pilot.task.waits_for(np.zeros(2)), pilot, robot, 30.0, seen)
    return pilot, robot, first, there, states, np.array(errors)


def test_it_stands_until_it_has_found_itself(driven) -> None:
    _, _, first, _, _, _ = driven
    lost = [each for each in first if each.reason.startswith(LOOKING)]
    assert len(lost) > 20
    assert not np.any([each.twist for each in lost])


def test_it_knows_its_pose_while_its_wheels_drift(driven) -> None:
    _, robot, _, _, _, errors = driven
    assert errors.mean() < 0.06
    assert errors.max() < 0.2
    assert robot.num_contacts == 0


def test_it_comes_to_rest_at_the_goal_and_waits(driven) -> None:
    _, _, _, there, states, _ = driven
    assert there[-1].mode is Mode.WAITING
    assert there[-1].reason == "at the goal"
    assert np.hypot(*(states[-1, :2] - [5.0, 3.0])) < 0.5


def test_it_keeps_out_of_areas_in_the_frame_of_the_map(driven) -> None:
    pilot, _, _, _, states, _ = driven
    assert pilot._mapper.is_closed(np.array([1.7, 3.3]))
    assert not pilot._mapper.is_closed(np.array([1.0, 1.0]))
    x, y = states[:, 0], states[:, 1]
    assert not ((x > 1.0) & (x < 2.4) & (y > 2.6) & (y < 4.0)).any()


def test_the_way_back_leads_to_where_it_found_itself(driven, drive_until) -> None:
    pilot, robot, *_ = driven
    pilot.task.turn_back(pilot.time, "told to return")
    commands, states = drive_until(lambda: pilot.finished, pilot, robot, 30.0, moved(ELSEWHERE))
    assert commands[-1].reason == "told to return; the robot is back at its start"
    assert np.hypot(*(states[-1, :2] - [1.0, 1.0])) < 0.5


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        (
            {"node": {"pose": "internal"}, "localisation": {"method": "particles"}},
            "localisation.method is 'particles'.*'matching', for the robot makes its own map",
        ),
        (
            {"node": {"pose": "internal", "map": "x.yaml"}, "localisation": {"method": "matching"}},
            "localisation.method is 'matching'.*'particles', for the robot knows its map",
        ),
        ({"node": {"map": "no/such.yaml"}}, "no/such.yaml is not there or not a file"),
    ],
)
def test_settings_that_do_not_go_together_are_refused(entries, said) -> None:
    with pytest.raises(ValueError, match=said):
        build_pilot(*make_node_settings(entries))
