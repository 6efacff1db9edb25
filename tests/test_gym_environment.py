import warnings

import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from tests.kinds import SMALL_GYM as SMALL

from jaxplore.gym.registration import ENVIRONMENT
from jaxplore.gym.vector_environment import _step_each
from jaxplore.report.drawing.palette import ROBOT

pytestmark = pytest.mark.long

NAME = f"jaxplore.gym:{ENVIRONMENT}"
TOGETHER = {"num_envs": 3, "vectorization_mode": "vector_entry_point"}


def is_recommendation(warning: warnings.WarningMessage) -> bool:
    """Say whether it is about actions that are in their own units, not in [-1, 1]."""
    return "we recommend using a symmetric and normalized space" in str(warning.message)


def option_entries(info: dict, index: int) -> dict:
    return {name: info[name][index] for name in info if not name.startswith("_")}


def check_same(first: dict, second: dict) -> None:
    assert first.keys() == second.keys()
    for name, values in first.items():
        np.testing.assert_allclose(values, second[name], atol=1e-5, err_msg=name)


@pytest.mark.parametrize("action", ["control", "waypoint"])
def test_gymnasiums_checker_finds_nothing(action) -> None:
    options = {"controller": {"num_samples": 32, "horizon": 20}} if action == "waypoint" else {}
    environment = gymnasium.make(NAME, action=action, **SMALL, **options)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        check_env(environment.unwrapped)
    assert [str(each.message) for each in found if not is_recommendation(each)] == []
    environment.close()


def test_the_spaces_hold_what_they_say() -> None:
    environment = gymnasium.make(NAME, **SMALL)
    space = environment.observation_space
    assert {name: box.shape for name, box in space.items()} == {
        "belief": (70, 80),
        "pose": (3,),
        "scan": (36,),
        "state": (5,),
    }
    np.testing.assert_allclose(space["pose"].high, [8.0, 7.0, np.pi], rtol=1e-6)
    np.testing.assert_allclose(space["state"].low, [0.0, 0.0, -np.pi, 0.0, -2.0], rtol=1e-6)
    np.testing.assert_allclose(space["state"].high, [8.0, 7.0, np.pi, 1.0, 2.0], rtol=1e-6)
    np.testing.assert_allclose(environment.action_space.high, [1.0, 2.0])
    view = gymnasium.make(NAME, action="waypoint", view=3.0, reach=2.5, **SMALL)
    assert view.observation_space["belief"].shape == (30, 30)
    np.testing.assert_allclose(view.action_space.low, [-2.5, -2.5])
    car = gymnasium.make(NAME, robot={"model": "ackermann"}, **{**SMALL, "num_floors": 1})
    np.testing.assert_allclose(car.observation_space["state"].high[3:], [1.0, 0.6], rtol=1e-6)
    flyer = {"architecture": "two-layer", "robot": {"model": "quadrotor"}, "num_floors": 1}
    quadrotor = gymnasium.make(NAME, **{**SMALL, **flyer})
    high = quadrotor.observation_space["state"].high
    np.testing.assert_allclose(high[:2], [8.0, 7.0])
    np.testing.assert_allclose(high[6:10], 1.0)
    assert np.isinf(high[[2, 3, 4, 5, 10, 11, 12]]).all()


def test_the_same_seed_and_actions_give_the_same_episode() -> None:
    def episode(seed: int) -> list:
        environment = gymnasium.make(NAME, render_mode="rgb_array", **SMALL)
        environment.action_space.seed(3)
        rows = [(environment.reset(seed=seed), ())]
        rows += [(environment.step(environment.action_space.sample()), ()) for _ in range(5)]
        rows += [(environment.reset(), ()), (environment.render(), ())]
        return jax.tree.leaves(rows)

    first, same, other = episode(0), episode(0), episode(1)
    for a, b in zip(first, same, strict=True):
        np.testing.assert_array_equal(a, b)
    assert any(not np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def test_a_floor_can_be_chosen_and_none_is_left_out() -> None:
    environment = gymnasium.make(NAME, **SMALL)
    beliefs = []
    for floor in (0, 1):
        observation, info = environment.reset(seed=4, options={"scenario": floor})
        assert info["scenario"] == floor
        beliefs.append(observation["belief"])
    assert not np.array_equal(*beliefs)
    drawn = {environment.reset()[1]["scenario"] for _ in range(20)}
    assert drawn == {0, 1}
    with pytest.raises(ValueError, match="option scenario is 2"):
        environment.reset(options={"scenario": 2})


def test_a_picture_shows_the_robot_on_its_map() -> None:
    environment = gymnasium.make(NAME, render_mode="rgb_array", **SMALL)
    environment.reset(seed=0)
    for _ in range(3):
        environment.step(np.array([1.0, 0.0]))
    image = environment.render()
    assert image.dtype == np.uint8
    assert image.shape == (560, 640, 3)  # 8 pixels a cell
    x, y = environment.unwrapped.state.moment.observed[:2]
    rows, columns = np.nonzero((image == ROBOT).all(axis=-1))
    np.testing.assert_allclose(columns.mean(), float(x) * 80.0, atol=4.0)
    np.testing.assert_allclose(rows.mean(), 560.0 - float(y) * 80.0, atol=4.0)


def test_many_at_once_are_as_each_alone_through_ends_and_new_beginnings() -> None:
    options = {**SMALL, "time_limit": 0.5}
    together = gymnasium.make_vec(
        NAME, num_envs=3, vectorization_mode="vector_entry_point", **options
    )
    one_by_one = gymnasium.make_vec(NAME, num_envs=3, vectorization_mode="sync", **options)
    assert together.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    assert together.observation_space == one_by_one.observation_space
    assert together.action_space == one_by_one.action_space
    for (observation, info), (other, other_info) in [
        (together.reset(seed=7), one_by_one.reset(seed=7)),
        (together.reset(seed=[3, None, 5]), one_by_one.reset(seed=[3, None, 5])),
    ]:
        check_same(observation, other)
        check_same(info, other_info)
    together.action_space.seed(0)
    num_ends = 0
    for _ in range(13):
        actions = together.action_space.sample()
        ours, theirs = together.step(actions), one_by_one.step(actions)
        check_same(ours[0], theirs[0])
        for a, b in zip(ours[1:4], theirs[1:4], strict=True):
            assert a.dtype == b.dtype
            np.testing.assert_allclose(a, b, atol=1e-4)
        check_same(ours[4], theirs[4])
        assert together.observation_space.contains(ours[0])
        num_ends += int(ours[3].sum())
    assert num_ends == 6
    # Some of them alone.
    mask = np.array([False, True, False])
    before = ours[0]["pose"]
    observation, info = together.reset(seed=11, options={"reset_mask": mask, "scenario": 1})
    assert info["time"][1] == 0.0
    assert info["scenario"][1] == 1
    np.testing.assert_array_equal(observation["pose"][~mask], before[~mask])
    together.close()


def test_mapped_over_at_once_or_one_after_the_other_is_the_same() -> None:
    pair = [gymnasium.make_vec(NAME, is_vmapped=way, **TOGETHER, **SMALL) for way in (False, True)]
    pair[0].action_space.seed(1)
    for environment in pair:
        environment.reset(seed=2)
    for _ in range(4):
        actions = pair[0].action_space.sample()
        (first, reward, *_), (second, other, *_) = (each.step(actions) for each in pair)
        check_same(first, second)
        np.testing.assert_allclose(reward, other, atol=1e-4)


def test_nothing_but_sizes_compiles_a_vector_step_again() -> None:
    def run(**options) -> None:
        environment = gymnasium.make_vec(
            NAME, **TOGETHER, **{**SMALL, "time_limit": 0.5, **options}
        )
        environment.reset(seed=0)
        environment.step(environment.action_space.sample())

    run()
    compiled = _step_each._cached._cache_size()
    run(office={"seed": 5, "width": 8.0, "height": 7.0}, time_limit=2.0)
    run(action_period=0.06, collision_penalty=0.0, robot={"max_speed": 0.5}, target_coverage=0.5)
    assert _step_each._cached._cache_size() == compiled
