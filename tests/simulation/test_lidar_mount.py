"""Motion by which a scan of a lidar that turns is measured and undone, and refusals of mounts."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.simulation.conftest import u_shaped_world

from jaxplore import DifferentialDrive, Lidar, Unicycle
from jaxplore.onboard.simulated_robot import SimulatedRobot
from jaxplore.sensing import LidarMount
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.state import Moment
from jaxplore.tasks.exploration.pilot import check_no_mount, make_node_settings
from jaxplore.tasks.exploration.settings import make_exploration_settings
from jaxplore.tasks.robot import build_sensors

pytestmark = pytest.mark.long


def scenario_with(robot, mount: LidarMount | None) -> ExplorationScenario:
    lidar = Lidar(num_beams=72, max_range=1.5, mount=mount)
    return ExplorationScenario(u_shaped_world(), robot, lidar, (3.0, 2.0, 0.7))


@jax.jit
def begin(scenario):
    return scenario.init(None)[0]


@jax.jit
def motion_of(scenario, state, seen):
    off = jnp.array(False)
    moment = Moment(jnp.zeros((), jnp.int32), jnp.zeros(()), seen, off, off)
    return scenario.instruments.scan_motion(state, moment)


def test_the_robot_knows_its_motion_by_what_it_observes() -> None:
    scenario = scenario_with(DifferentialDrive(), LidarMount(is_turning=True))
    state = begin(scenario)._replace(robot=np.float32([3.0, 2.0, 0.7, 0.8, -1.1]))
    # A robot that does not know its pose knows its velocity.
    seen = np.float32([np.nan, np.nan, np.nan, 0.7, -1.0])
    motion = motion_of(scenario, state, seen)
    np.testing.assert_allclose(motion.true, [0.8, 0.0, -1.1], atol=1e-5)
    np.testing.assert_allclose(motion.known, [0.7, 0.0, -1.0], atol=1e-5)
    assert float(motion.duration) == pytest.approx(0.1)


def test_a_velocity_that_is_a_control_is_that_of_the_last_step() -> None:
    scenario = scenario_with(Unicycle(), LidarMount(is_turning=True))
    state = begin(scenario)
    state = state.after_step(state.robot, jnp.asarray([0.6, 0.9]))
    motion = motion_of(scenario, state, np.asarray(state.robot))
    np.testing.assert_allclose(motion.true, [0.6, 0.0, 0.9], atol=1e-5)
    np.testing.assert_allclose(motion.known, [0.6, 0.0, 0.9], atol=1e-5)


@pytest.mark.parametrize("mount", [None, LidarMount(0.2)])
def test_without_a_turn_nothing_is_kept(mount: LidarMount | None) -> None:
    state = jax.eval_shape(begin, scenario_with(DifferentialDrive(), mount))
    assert state.control is None


def test_settings_make_a_mount_only_where_they_say_so() -> None:
    def lidar(**entries: object) -> Lidar:
        settings = make_exploration_settings({"map": "office", "lidar": entries})
        (found,) = build_sensors(settings)
        assert isinstance(found, Lidar)
        return found

    assert lidar().mount is None
    mount = lidar(x=0.25, y=-0.1, yaw_degrees=40.0, is_turning=True).mount
    assert mount is not None
    assert mount.is_turning
    given = [float(each) for each in (mount.x, mount.y, mount.yaw)]
    assert given == pytest.approx([0.25, -0.1, math.radians(40.0)])
    with pytest.raises(ValueError, match=r"lidar\.x is 11"):
        lidar(x=11.0)


def test_who_has_another_place_for_it_refuses_a_mount() -> None:
    with pytest.raises(ValueError, match=r"setting lidar\.yaw_degrees is 40\.0.*node\.lidar_x"):
        make_node_settings({"lidar": {"yaw_degrees": 40.0}})
    settings = make_exploration_settings({"map": "office", "lidar": {"is_turning": True}})
    with pytest.raises(ValueError, match=r"setting lidar\.is_turning is True.*accepted: False"):
        check_no_mount(settings, "--turning")
    scenario = scenario_with(DifferentialDrive(), LidarMount(0.1))
    with pytest.raises(ValueError, match="the lidar of the scenario has a mount"):
        SimulatedRobot(scenario, jax.random.key(0))
