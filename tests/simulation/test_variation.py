"""Domain randomisation: a true robot that differs from episode to episode."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from tests.kinds import Yard

import jaxplore as jx
from jaxplore.control.base import Controller, Info
from jaxplore.parts.variation.plant import ContinuousPlant, Plant, as_plant
from jaxplore.simulation.loop import copy_tree, initial_loop_state, run_chunk
from jaxplore.tasks.registry import build, make_settings

pytestmark = pytest.mark.long

ROBOT = jx.DifferentialDrive(max_speed=1.0, drag=0.1)
KEY = jax.random.key(3)
RUNS = jax.random.split(KEY, 50)
PERIOD, STEPS = jnp.asarray(0.05), 40
VARIED = jx.Variation(
    {"drag": (0.0, 0.5), "control_max[0]": (0.5, 0.9)},
    gain=(0.7, 1.1),
    slip=(0.05, 0.3),
    turn_slip=(0.1, 0.2),
    control_delay=(0, 3),
)


class Hold(Controller):
    """Gives one command all the time, and remembers what it observed last."""

    command: jax.Array
    size: int

    def init(self):
        return jnp.zeros(self.size)

    def step(self, state, observation, belief=None, *, key):
        one = jnp.ones(())
        info = Info(self.command[None], one[None], one[None], one, jnp.array(True))
        return self.command, observation, info

    def inspect(self, state, observation, belief=None, *, key, num_trajectories=50):
        raise NotImplementedError

    def at_period(self, control_period):
        return self


HOLD, YARD = Hold(jnp.asarray([1.0, 0.6]), 5), Yard(ROBOT)


def drive(controller: Controller, scenario: jx.Scenario, key: jax.Array):
    """Return the records of a run, and the state of the loop at its end."""
    state = initial_loop_state(controller, scenario, key)
    steps = jnp.asarray(STEPS, jnp.int32)
    state, records, _ = run_chunk((controller, scenario, key, steps), copy_tree(state), STEPS)
    return records, state


def test_draws_are_uniform_and_independent() -> None:
    variation = jx.Variation(
        {"drag": (0.0, 0.4), "max_speed": (0.5, 1.5)},
        gain=(0.6, 1.0),
        slip=(0.0, 0.2),
        turn_slip=(0.1, 0.3),
        control_delay=(1, 4),
        heading_noise=(0.0, 0.1),
    )
    keys = jax.random.split(KEY, 2000)
    drawn = jax.vmap(lambda key: variation.draw(key, ROBOT))(keys)
    columns = {
        (0.0, 0.4): drawn.parameters["drag"],
        (0.5, 1.5): drawn.parameters["max_speed"],
        (0.6, 1.0): drawn.gain[:, 0],
        (0.0, 0.2): drawn.slip,
        (0.1, 0.3): drawn.turn_slip,
        (0.0, 0.1): drawn.heading_noise,
    }
    for (low, high), values in columns.items():
        found = np.asarray(values)
        assert low <= found.min() and found.max() <= high  # noqa: PT018
        assert stats.kstest(found, stats.uniform(low, high - low).cdf).pvalue > 1e-3
    counts = np.bincount(np.asarray(drawn.control_delay), minlength=5)
    assert counts[0] == 0
    assert stats.chisquare(counts[1:]).pvalue > 1e-3
    together = np.corrcoef(np.stack([np.asarray(each) for each in columns.values()]))
    assert np.abs(together - np.eye(len(together))).max() < 0.1
    # What does not vary has its value, and without a key nothing is random.
    np.testing.assert_array_equal(drawn.position_noise, 0.0)
    middle = variation.draw(None, ROBOT)
    assert float(middle.parameters["drag"]) == pytest.approx(0.2)
    assert float(middle.slip) == pytest.approx(0.1)


def test_slip_and_gain_are_those_of_the_formula() -> None:
    nothing = jnp.zeros(2)
    plant = as_plant(ROBOT, jnp.asarray([0.5, 0.8]), nothing, jnp.asarray(0.2), jnp.asarray(0.4))
    assert isinstance(plant, ContinuousPlant)
    state = jnp.asarray([1.0, 2.0, 0.3, 0.6, -0.5])
    control = jnp.asarray([9.0, 1.0])  # the first is beyond its bound, 1
    x, y, yaw, v, omega = state.tolist()
    found = np.asarray(plant.step(state, control, PERIOD))
    expected = [
        x + 0.8 * 0.05 * v * np.cos(yaw),
        y + 0.8 * 0.05 * v * np.sin(yaw),
        yaw + 0.6 * 0.05 * omega,
        v + 0.05 * (0.5 * 1.0 - 0.1 * v),
        omega + 0.05 * (0.8 * 1.0 - 0.1 * omega),
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    same = as_plant(ROBOT, jnp.ones(2), nothing, jnp.zeros(()), jnp.zeros(()))
    inside = jnp.asarray([0.4, 1.0])
    np.testing.assert_array_equal(
        same.step(state, inside, PERIOD), ROBOT.step(state, inside, PERIOD)
    )
    # Everything but the motion is the model's.
    assert plant.state_names == ROBOT.state_names
    np.testing.assert_array_equal(plant.pose(state), ROBOT.pose(state))
    np.testing.assert_array_equal(
        plant.resolve_collision(state, state + 1), ROBOT.resolve_collision(state, state + 1)
    )
    still = plant.stopping_control(state, PERIOD)
    np.testing.assert_array_equal(still, ROBOT.stopping_control(state, PERIOD))
    assert type(as_plant(jx.PointMass(2), *[jnp.zeros(2)] * 2, *[jnp.zeros(())] * 2)) in (
        Plant,
        ContinuousPlant,
    )


def test_only_the_physical_part_of_a_path_follower_varies() -> None:
    model = jx.mpcc(jx.Ackermann(), jx.race_track(seed=1)).model
    drawn = jx.Variation({"drag": (0.3, 0.3)}, gain=(0.5, 0.5)).draw(KEY, model)
    varied = jx.Variation({"drag": (0.3, 0.3)}).true_robot(model, drawn, KEY)
    assert float(varied.physical.model.drag) == pytest.approx(0.3)
    state = model.at_pose(0.0, 0.0, 0.0)
    control = jnp.asarray([1.0, 0.0, 2.0])
    before, after = (each.step(state, control, PERIOD) for each in (model, varied))
    assert float(after[-1]) == float(before[-1])
    assert float(model.speed(after)) < 0.6 * float(model.speed(before))


def in_numpy(drawn) -> np.ndarray:
    """Return the states of a run with a draw, by the formulas in double precision."""
    state, states = np.zeros(5), []
    drag, highest = (float(drawn.parameters[name]) for name in ("drag", "control_max[0]"))
    bounds = np.array([highest, 2.0])
    keeps = 1.0 - np.array([float(drawn.slip)] * 2 + [float(drawn.turn_slip)])
    for step in range(STEPS):
        is_late = step < int(drawn.control_delay)
        command = np.zeros(2) if is_late else np.array([1.0, 0.6])
        a, alpha = np.asarray(drawn.gain) * np.clip(command, -bounds, bounds)
        _, _, yaw, v, omega = state
        pose = keeps * 0.05 * np.array([v * np.cos(yaw), v * np.sin(yaw), omega])
        speeds = [v + 0.05 * (a - drag * v), omega + 0.05 * (alpha - drag * omega)]
        state = np.concatenate([state[:3] + pose, np.clip(speeds, [0.0, -2.0], [1.0, 2.0])])
        states.append(state)
    return np.stack(states)


def test_a_run_is_that_of_the_robot_that_was_drawn() -> None:
    task, ends = YARD.with_disturbances([VARIED]), set()
    for seed in range(4):
        key = jax.random.key(seed)
        (states, observed), loop = drive(HOLD, task, key)
        drawn = VARIED.draw(key, ROBOT)
        np.testing.assert_array_equal(loop.drawn["variation"].gain, drawn.gain)
        np.testing.assert_allclose(states, in_numpy(drawn), atol=2e-5)
        np.testing.assert_array_equal(observed[1:], states[:-1])
        ends.add(float(states[-1, 0]))
    assert len(ends) == 4
    before = run_chunk._cached._cache_size()
    drive(HOLD, YARD.with_disturbances([VARIED]), jax.random.key(9))
    assert run_chunk._cached._cache_size() == before


def test_without_variation_a_run_is_as_it_was() -> None:
    (plain, _), loop = drive(HOLD, YARD, KEY)
    assert loop.drawn == {}
    (same, _), _ = drive(HOLD, YARD.with_disturbances([jx.Variation()]), KEY)
    np.testing.assert_allclose(plain, same, atol=1e-6)


def test_vmap_over_keys_has_a_robot_in_each_run() -> None:
    task = YARD.with_disturbances([VARIED])
    together, _ = jax.vmap(lambda key: drive(HOLD, task, key))(RUNS)
    for states, key in zip(together[0][:3], RUNS[:3], strict=True):
        np.testing.assert_allclose(states, in_numpy(VARIED.draw(key, ROBOT)), atol=2e-5)


def test_noise_is_that_of_the_commands_and_of_the_observations() -> None:
    variation = jx.Variation(
        {"drag": (0.0, 0.0), "control_max[0]": (1.0, 1.0)},
        control_noise=(0.2, 0.2),
        position_noise=(0.05, 0.05),
        control_delay=(0, 3),
    )
    still = Hold(jnp.asarray([0.4, 0.0]), 5)
    robot = jx.DifferentialDrive(max_speed=10.0, drag=0.1)
    (states, observed), _ = jax.vmap(
        lambda key: drive(still, Yard(robot).with_disturbances([variation]), key)
    )(RUNS)
    turned = np.diff(states[..., 4], axis=1) / 0.05
    # The bound of alpha is 2, and a fifth of it is its noise.
    assert np.std(turned) == pytest.approx(0.4, rel=0.05)
    lag = np.corrcoef(turned[:, 1:].ravel(), turned[:, :-1].ravel())[0, 1]
    assert abs(lag) < 0.1
    off = np.asarray(observed[:, 1:] - states[:, :-1])
    np.testing.assert_allclose(off.std((0, 1)), [0.05, 0.05, 0.0, 0.0, 0.0], rtol=0.05)


def test_it_holds_for_path_following_and_commands_come_late_there_too() -> None:
    """For explorations too: `test_guard.py`."""
    model = jx.mpcc(jx.Ackermann(), jx.race_track(seed=1)).model
    faults = jx.Faults(control_delay=3)
    path = jx.PathScenario(model, jx.race_track(seed=1), control_rate=20.0)
    hold = Hold(jnp.asarray([0.5, 0.0, 0.5]), path.robot.state_size)
    records, _ = drive(hold, path.with_disturbances([jx.Variation(slip=(0.3, 0.3)), faults]), KEY)
    # Three commands are under way before the first one takes effect, which is no fault.
    np.testing.assert_array_equal(records.control[:3], np.zeros((3, 3)))
    np.testing.assert_array_equal(records.control[3:], np.tile(hold.command, (STEPS - 3, 1)))
    assert not records.is_faulty.any()

    @jax.jit
    def after(state):
        def step(_, state):
            return path.robot.step(state, hold.command, PERIOD)

        return jax.lax.fori_loop(3, STEPS, step, state)

    # The drive is straight, so the model alone says how far it goes without slip.
    whole, slipped = (
        float(jnp.linalg.norm(path.robot.position(end - path.start)))
        for end in (after(path.start), records.state[-1])
    )
    assert whole > 0.5
    assert slipped == pytest.approx(0.7 * whole, rel=1e-3)


def test_settings_describe_it_for_every_kind_of_task() -> None:
    section = {"gain": [0.7, 1.0], "slip": [0.0, 0.2], "parameters": {"drag": [0.0, 0.3]}}
    for entries in ({"map": "office"}, {"path": "track"}):
        assert build(make_settings(entries)).scenario.disturbed_by == ()
        (variation,) = build(make_settings({**entries, "variation": section})).scenario.disturbed_by
        np.testing.assert_allclose(variation.gain, [0.7, 1.0])
        np.testing.assert_allclose(variation.parameters["drag"], [0.0, 0.3])
    assert Yard(ROBOT, disturbed_by=(VARIED,)).disturbed_by[0] is VARIED
    assert YARD.with_disturbances([VARIED]).with_disturbances([]).disturbed_by == ()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            {"gain": (0.0, 1.0)},
            r"gain is \[0, 1\]; accepted: two numbers, low <= high, 0 < low",
        ),
        ({"slip": (0.3, 0.1)}, r"slip is \[0.3, 0.1\]; accepted: two numbers, low <= high"),
        ({"control_delay": (2, 1)}, r"control_delay is \(2, 1\); accepted: two whole numbers"),
        ({"parameters": {"drag": 0.1}}, r"parameters\['drag'\] "),
    ],
    ids=str,
)
def test_what_is_no_interval_is_refused(given, said) -> None:
    with pytest.raises(ValueError, match=rf"^{said}"):
        jx.Variation(**given)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("wings", r"parameter wings is not known; accepted: such as"),
        ("control_max", r"parameter control_max has 2 elements; accepted: control_max\[0\] to"),
        ("control_max[2]", r"parameter control_max\[2\] has no element 2"),
        ("control_max[x]", r"parameter is 'control_max\[x\]'; accepted: a path"),
        ("max_speed", r"parameters\['max_speed'\] is \[-1.0, 2.0\] for a robot with 1; .*>= 0"),
    ],
)
def test_a_parameter_that_the_robot_does_not_have_is_refused(name, said) -> None:
    with pytest.raises(ValueError, match=rf"^{said}"):
        YARD.with_disturbances([jx.Variation({name: (-1.0, 2.0)})])
