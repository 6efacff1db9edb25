"""What environments of Gymnasium take and refuse, and that of a path; episodes are in
test_gym_environment.py."""

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from tests.kinds import SMALL_GYM as SMALL

from jaxplore import DifferentialDrive, Lidar, office, start_pose
from jaxplore.gym.registration import ENVIRONMENT, register_environment
from jaxplore.simulation.exploration.scenario import ExplorationScenario

NAME = f"jaxplore.gym:{ENVIRONMENT}"


def test_a_scenario_of_ones_own_is_taken() -> None:
    world = office(seed=1, width=8.0, height=7.0)
    scenario = ExplorationScenario(world, DifferentialDrive(), Lidar(18, 2.0), start_pose(world))
    environment = gymnasium.make(NAME, scenario=scenario, time_limit=3.0)
    assert environment.observation_space["scan"].shape == (18,)
    assert int(environment.unwrapped.environment.max_steps) == 150


@pytest.mark.long
def test_an_agent_commands_all_robots_of_a_fleet_at_once() -> None:
    environment = gymnasium.make(NAME, fleet={"robots": 2}, **SMALL)
    assert environment.action_space.shape == (4,)
    observation, _ = environment.reset(seed=0)
    after, _, terminated, _, _ = environment.step(np.array([1.0, 0.0, 1.0, 0.0], np.float32))
    moved = np.abs(after["state"] - observation["state"])
    assert not terminated
    # Both drive ahead, and no guard brakes them.
    assert (moved.reshape(2, -1)[:, :2].max(axis=1) > 0.0).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"action": "teleport"}, "action is 'teleport'; accepted: control, waypoint"),
        ({"time_limit": -1.0}, "time_limit is -1"),
        ({"map": "nowhere.yaml", "start": (0.0, 0.0, 0.0)}, "nowhere.yaml"),
        ({"map": "zones", "num_floors": 2}, "num_floors is 2; accepted: 1, or the map office"),
        ({"num_floors": 0}, "num_floors is 0"),
        ({"seed": 3}, "accepted: a seed of its reset"),
        ({"colour": "red"}, "colour"),
        ({"controller": 3}, "controller"),
        ({"render_mode": "human"}, "render_mode is 'human'"),
        ({"scenario": "office"}, "scenario is 'office'"),
        ({"scenario": []}, r"scenario is \[\]"),
        ({"scenario": [], "lidar": {}}, "setting lidar is given beside a scenario"),
        ({"scenario": [], "num_floors": 2}, "num_floors is 2 beside a scenario"),
        ({"architecture": "two-layer", "action": "waypoint"}, "a robot on the ground"),
    ],
)
def test_bad_options_are_refused(options, message) -> None:
    from jaxplore.gym.environment import ScenarioEnvironment

    with pytest.raises(ValueError, match=message):
        ScenarioEnvironment(**options)


def test_bad_actions_and_a_step_before_the_first_reset_are_refused() -> None:
    environment = gymnasium.make(NAME, **SMALL).unwrapped
    with pytest.raises(gymnasium.error.ResetNeeded):
        environment.step(np.zeros(2))
    environment.reset(seed=0)
    with pytest.raises(ValueError, match="action is"):
        environment.step(np.zeros(3))
    with pytest.raises(ValueError, match="action is"):
        environment.step(np.array([np.nan, 0.0]))
    several = gymnasium.make_vec(NAME, num_envs=2, **SMALL)
    with pytest.raises(gymnasium.error.ResetNeeded):
        several.step(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="seed has 3 values"):
        several.reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match="reset_mask"):
        several.reset(options={"reset_mask": np.ones(3, bool)})
    with pytest.raises(ValueError, match="num_envs is 0"):
        gymnasium.make_vec(NAME, num_envs=0, **SMALL)


def test_registering_twice_changes_nothing() -> None:
    register_environment()
    spec = gymnasium.spec(ENVIRONMENT)
    register_environment()
    assert gymnasium.spec(ENVIRONMENT) is spec


def test_importing_jaxplore_neither_imports_gymnasium_nor_registers_anything() -> None:
    program = (
        "import sys, jaxplore\n"
        "assert 'gymnasium' not in sys.modules and 'jaxplore.gym' not in sys.modules\n"
        "import gymnasium\n"
        "assert not any('jaxplore' in name for name in gymnasium.registry)\n"
        "import jaxplore.gym\n"
        f"assert {ENVIRONMENT!r} in gymnasium.registry\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)


@pytest.mark.long
def test_a_path_is_an_environment_like_any_other() -> None:
    """Held controls give the states of the closed loop, and progress is what is earned."""
    register_environment()
    environment = gymnasium.make(
        "jaxplore/PathFollowing-v0",
        obstacles={"number": 2},
        time_limit=2.0,
        render_mode="rgb_array",
        disable_env_checker=True,
    )
    observed, info = environment.reset(seed=3)
    assert environment.observation_space.contains(observed)
    assert observed["path"].shape == (12, 2)
    assert observed["obstacles"].shape == (2, 5)
    # Along a track of 1 m points, the first is about 1 m ahead.
    np.testing.assert_allclose(np.linalg.norm(observed["path"][0]), 1.0, atol=0.1)
    before, earned, ended = info["progress"], 0.0, False
    action = np.zeros(environment.action_space.shape, np.float32)
    action[0] = 1.0
    while not ended:
        observed, reward, terminated, truncated, info = environment.step(action)
        earned, ended = earned + reward, terminated or truncated
    assert truncated
    assert info["time"] == pytest.approx(2.0)
    contact = info["collision_steps"] * 0.02
    assert earned == pytest.approx(info["progress"] - before - contact, abs=1e-3)
    assert environment.render().ndim == 3
    with pytest.raises(ValueError, match="action is 'waypoint'; accepted: control"):
        gymnasium.make("jaxplore/PathFollowing-v0", action="waypoint")
