import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.simulation import batch as batches
from jaxplore.simulation.batch import record_runs
from jaxplore.simulation.run import record_run

pytestmark = pytest.mark.long

KEYS = jax.random.split(jax.random.key(3), 3)
STEPS = 300


@pytest.fixture(scope="module")
def experiment(make):
    return make(target=0.35)


@pytest.fixture(scope="module")
def together(experiment):
    return record_runs(*experiment, STEPS, keys=KEYS)


def test_each_run_is_that_of_its_key_alone(experiment, together) -> None:
    """But for rounding, which grows: at first they are the same."""
    for key, run in zip(KEYS, together, strict=True):
        alone = record_run(*experiment, STEPS, key=key, num_trajectories=0)
        for name in ("state", "control", "coverage", "entropy", "clearance"):
            ours, theirs = (getattr(one.records, name)[:60] for one in (run, alone))
            np.testing.assert_allclose(ours, theirs, rtol=2e-2, atol=2e-3, err_msg=name)
        assert run.initial_coverage == alone.initial_coverage
        assert run.num_steps == pytest.approx(alone.num_steps, rel=0.1)


def test_each_run_ends_when_it_is_finished(together, check_frames) -> None:
    lengths = [run.num_steps for run in together]
    assert len(set(lengths)) > 1
    for run in together:
        assert run.finished_step == run.num_steps < STEPS
        covered = run.records.coverage >= 0.35
        assert covered[-1]
        assert not covered[:-1].any()
        assert all(len(rows) == run.num_steps for rows in jax.tree.leaves(run.records))
        check_frames(run)


def test_a_run_does_not_depend_on_the_others_and_nothing_compiles_again(
    experiment, together
) -> None:
    before = batches._run_chunk._cached._cache_size()
    others = jnp.stack([KEYS[0], jax.random.key(8), jax.random.key(9)])
    again = record_runs(*experiment, STEPS, keys=others)
    assert batches._run_chunk._cached._cache_size() == before
    same = jax.tree.map(np.array_equal, again[0].records, together[0].records)
    assert all(jax.tree.leaves(same))
    assert not np.array_equal(again[1].records.state[:50], together[1].records.state[:50])


def test_runs_of_a_batch_stop_at_the_limit(experiment) -> None:
    runs = record_runs(*experiment, 30, keys=KEYS)
    assert [run.num_steps for run in runs] == [30, 30, 30]
    assert [run.finished_step for run in runs] == [None] * 3


@pytest.mark.parametrize("keys", [KEYS[0], KEYS[:0]])
def test_bad_input_is_named(experiment, keys) -> None:
    with pytest.raises(ValueError, match=r"keys .* shape .*accepted"):
        record_runs(*experiment, 10, keys=keys)
