import itertools
import signal
import threading

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.information.belief import Belief
from jaxplore.simulation.closed_loop import initial_loop_state, run_chunk
from jaxplore.simulation.simulate import record_run

CHUNK = 25  # record_run's own, so that nothing is compiled twice


def run(experiment, steps: int, key: jax.Array, pieces: int = 1):
    controller, scenario = experiment
    controller = controller.at_period(scenario.control_period)
    state, rows = initial_loop_state(controller, scenario), []
    for _ in range(pieces):
        for _ in range(0, steps // pieces, CHUNK):
            count = min(CHUNK, steps // pieces)
            state, records, done = run_chunk(
                controller, scenario, state, key, jnp.asarray(count), CHUNK
            )
            rows.append(jax.tree.map(lambda leaf, n=int(done): np.asarray(leaf)[:n], records))
    return state, jax.tree.map(lambda *parts: np.concatenate(parts), *rows)


@pytest.fixture(scope="session")
def explored(make):
    """One long run out of the U, shared by the tests that look at it."""
    controller, scenario = make()
    return record_run(controller, scenario, 6000, key=jax.random.key(0)), scenario


def test_gets_out_of_a_u_and_sees_everything_without_touching(explored) -> None:
    recording, _ = explored
    assert recording.records.coverage[-1] >= 0.9
    assert recording.num_steps < 6000
    assert not recording.records.is_collision.any()
    assert recording.records.clearance.min() > 0.0
    assert recording.records.is_finite.all()
    behind = recording.positions[:, 0] > 4.3
    assert behind.any()


def test_coverage_never_falls_much_and_entropy_drops(explored) -> None:
    recording, _ = explored
    records = recording.records
    assert np.diff(records.coverage).min() > -0.02
    assert records.entropy[-1] < 0.2 * recording.initial_entropy


def test_the_belief_agrees_with_the_world(explored) -> None:
    recording, scenario = explored
    reachable = np.asarray(scenario.reachable)
    known_free = recording.belief < 0.25
    assert (recording.world[known_free] >= 0.25).mean() < 0.01
    wrong = (recording.belief > 0.65) & reachable & (recording.world < 0.25)
    assert wrong.sum() < 0.01 * reachable.sum()


def test_recorded_states_follow_from_the_recorded_controls(explored) -> None:
    recording, scenario = explored
    states = np.concatenate([recording.start[None], recording.records.state])
    step = jax.jit(jax.vmap(scenario.robot.step, in_axes=(0, 0, None)))
    period = jnp.asarray(recording.control_period, jnp.float32)
    moved = step(states[:-1], recording.records.control, period)
    np.testing.assert_allclose(states[1:], moved, atol=1e-5)


def test_frames_cover_the_run(explored) -> None:
    recording, _scenario = explored
    steps = [frame.step for frame in recording.frames]
    assert steps[0] == 0
    assert steps[-1] == recording.num_steps
    assert steps == sorted(set(steps))
    last = recording.frames[-1]
    np.testing.assert_array_equal(last.state, recording.records.state[-1])
    expected = np.round(255 * recording.belief).astype(np.uint8)
    np.testing.assert_array_equal(last.probability, expected)
    assert last.samples.shape == (60, 31, 2)
    assert set(last.terms) == {"ObstacleCost", "InformationCost", "GuidanceCost", "ControlCost"}
    assert len(recording.timing.step_seconds) > 0


def test_the_same_key_gives_the_same_run_however_it_is_cut(make) -> None:
    whole = run(make(), 50, jax.random.key(7))
    pieces = run(make(), 50, jax.random.key(7), pieces=10)
    other = run(make(), 50, jax.random.key(8))
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(pieces), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(whole[1].state, other[1].state)


def test_nothing_but_sizes_recompiles(make, other_world) -> None:
    run(make(), 5, jax.random.key(0))
    compiled = run_chunk._cached._cache_size()
    for experiment, seed in (
        (make(other_world), 0),
        (make(start=(1.0, 1.0, 2.0)), 0),
        (make(guidance_weight=3.0, information_weight=0.5), 0),
        (make(temperature=1.0, noise_std=(0.3, 0.4)), 0),
        (make(target=0.5), 0),
        (make(rates={"control_rate": 40.0, "sensing_rate": 20.0, "field_rate": 4.0}), 0),
        (make(), 99),
    ):
        run(experiment, 5, jax.random.key(seed))
    assert run_chunk._cached._cache_size() == compiled


def test_senses_and_plans_at_the_rates_given(make) -> None:
    rates = {"control_rate": 50.0, "sensing_rate": 10.0, "field_rate": 5.0}
    controller, scenario = make(rates=rates)
    controller = controller.at_period(scenario.control_period)
    state, key = initial_loop_state(controller, scenario), jax.random.key(0)
    maps, guidances = [], []
    for _ in range(21):
        state, _, _ = run_chunk(controller, scenario, state, key, jnp.asarray(1), CHUNK)
        belief: Belief = state.belief
        maps.append(np.asarray(belief.grid.probability))
        guidances.append(np.asarray(belief.guidance.values))
    changed = [not np.array_equal(a, b) for a, b in itertools.pairwise(maps)]
    replanned = [not np.array_equal(a, b) for a, b in itertools.pairwise(guidances)]
    assert set(np.flatnonzero(changed) + 1) <= {5, 10, 15, 20}
    assert set(np.flatnonzero(replanned) + 1) == {10, 20}


def test_stops_at_the_target(make) -> None:
    controller, scenario = make(target=0.3)
    recording = record_run(controller, scenario, 6000, key=jax.random.key(0))
    assert recording.records.coverage[-1] >= 0.3
    assert (recording.records.coverage[:-1] < 0.3).all()
    assert recording.num_steps < 1000


def test_a_wall_stops_the_robot_and_is_counted(make) -> None:
    controller, scenario = make(obstacle_weight=0.0, guidance_weight=0.0, information_weight=0.0)
    scenario = eqx.tree_at(lambda s: s.start, scenario, jnp.asarray([5.6, 2.0, 0.0, 1.0, 0.0]))
    _, records = run((controller, scenario), 25, jax.random.key(0))
    assert records.is_collision.any()
    assert (records.clearance >= 0.0).all()
    assert records.state[:, 0].max() < 5.9 - 0.2 + 1e-3
    first = int(np.argmax(records.is_collision))
    assert records.state[first, 3] == 0.0


def test_ctrl_c_keeps_what_was_done(make) -> None:
    controller, scenario = make()
    seen = []

    def stop(progress) -> None:
        seen.append(progress)
        if len(seen) == 2:
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    recording = record_run(controller, scenario, 6000, key=jax.random.key(0), on_progress=stop)
    assert recording.is_interrupted
    assert recording.num_steps == 50
    assert signal.getsignal(signal.SIGINT) is before
    whole = run(make(), 50, jax.random.key(0))[1]
    np.testing.assert_array_equal(recording.records.state, whole.state)


def test_runs_outside_the_main_thread(make) -> None:
    controller, scenario = make()
    results = []
    thread = threading.Thread(
        target=lambda: results.append(record_run(controller, scenario, 5, key=jax.random.key(0)))
    )
    thread.start()
    thread.join()
    assert results[0].num_steps == 5


def test_num_steps_must_be_positive(make) -> None:
    with pytest.raises(ValueError, match="num_steps is 0"):
        record_run(*make(), 0, key=jax.random.key(0))
