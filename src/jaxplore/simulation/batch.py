"""Runs that differ in their keys only, side by side in one compiled loop."""

import functools
import time
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, PRNGKeyArray

from jaxplore import _checks
from jaxplore._types import Count, Flag
from jaxplore.control.base import Controller
from jaxplore.simulation.chunks import CHUNK_SECONDS, Watched, loop, watch
from jaxplore.simulation.closed_loop import (
    LoopState,
    closed_loop_step,
    initial_loop_state,
    is_unfinished,
)
from jaxplore.simulation.record import Record, blank_records
from jaxplore.simulation.recording import Frame, Recording
from jaxplore.simulation.scenario import Scenario
from jaxplore.simulation.simulate import (
    Look,
    frame_of,
    look_at,
    period_of,
    recording_of,
)


class Batch(NamedTuple):
    """Runs at the same time.

    Args:
        states: with a leading axis of runs; each knows its own steps.
        clock: steps that those have done that go on. It is the same for all, which so sense and
            derive no more often than one does.
    """

    states: LoopState
    clock: Count


def record_runs(
    controller: Controller,
    scenario: Scenario,
    num_steps: int,
    *,
    keys: PRNGKeyArray,
) -> tuple[Recording, ...]:
    """Simulate several runs by `jax.vmap`, each until it is finished or the steps are done.

    Made for accelerators. A processor is busy with one run: there it takes longer than one after
    the other. Each run is that of `record_run` with the same key but for rounding, which in the end
    makes it another one; the same keys give the same runs. The looks are those of
    `num_trajectories=0`, and the times those of the steps of all runs together.

    Ctrl-C ends all runs after the current chunk; what was done is returned.

    Args:
        controller: decides.
        scenario: where and how.
        num_steps: at most, in control periods.
        keys: (B,) one for each run.

    Raises:
        ValueError: a number of steps < 1; no keys.
    """
    limit = _checks.positive_int("num_steps", num_steps)
    if keys.ndim != 1 or not len(keys):
        raise ValueError(f"keys has shape {keys.shape}; accepted: (B,), one for each run")
    period = period_of(scenario)
    controller = controller.at_period(scenario.control_period)
    scenario = eqx.tree_at(lambda one: one.perception, scenario, scenario.perception.for_batches())
    chunk = max(1, round(CHUNK_SECONDS / period))
    began = time.perf_counter()
    before = _begin(controller, scenario, keys)

    def run(batch: Batch, steps: Count) -> tuple[Batch, Record, Count]:
        return _run_chunk(controller, scenario, batch, keys, steps, chunk)

    def look(batch: Batch, step: int) -> tuple[Frame, ...]:
        seen = jax.tree.map(np.asarray, _look(controller, scenario, batch.states, keys))
        steps = np.asarray(batch.states.step).tolist()
        return tuple(
            frame_of(_of_run(seen, i), done, done * period) for i, done in enumerate(steps)
        )

    together = watch(
        run,
        lambda batch: jnp.any(_going_on(scenario, batch.states)),
        look,
        before,
        began=began,
        limit=limit,
        chunk=chunk,
        on_chunk=lambda *_: None,
    )
    return tuple(
        recording_of(controller, scenario, _of_run(before.states, i), _alone(together, i))
        for i in range(len(keys))
    )


def _of_run[T](together: T, i: int) -> T:
    """Return what is one run's of arrays with a leading axis of runs."""
    alone: T = jax.tree.map(lambda leaf: leaf[i], together)
    return alone


def _alone(
    together: Watched[Batch, Record, tuple[Frame, ...]], i: int
) -> Watched[LoopState, Record, Frame]:
    """Return one of the runs as if it had been alone."""
    state = _of_run(together.state.states, i)
    num_steps = int(state.step)
    # Those after its end are all the same.
    frames = {frames[i].step: frames[i] for frames in together.frames}
    return Watched(
        state,
        jax.tree.map(lambda leaf: leaf[:num_steps, i], together.records),
        tuple(frames.values()),
        together.timing,
        num_steps,
        together.is_interrupted,
    )


@eqx.filter_jit
def _begin(controller: Controller, scenario: Scenario, keys: PRNGKeyArray) -> Batch:
    def one(key: PRNGKeyArray) -> LoopState:
        return initial_loop_state(controller, scenario, key)

    return Batch(jax.vmap(one)(keys), jnp.zeros((), jnp.int32))


def _going_on(scenario: Scenario, states: LoopState) -> Bool[Array, " B"]:
    def one(state: LoopState) -> Flag:
        return is_unfinished(scenario, state)

    return jax.vmap(one)(states)


@eqx.filter_jit
def _run_chunk(
    controller: Controller,
    scenario: Scenario,
    batch: Batch,
    keys: PRNGKeyArray,
    num_steps: Count,
    capacity: int,
) -> tuple[Batch, Record, Count]:
    """Run up to `num_steps` steps, fewer if all runs are finished; see `run_chunk`."""

    def step(batch: Batch) -> tuple[Batch, Record]:
        states, clock = batch

        def one(state: LoopState, key: PRNGKeyArray) -> tuple[LoopState, Record]:
            return closed_loop_step(controller, scenario, state._replace(step=clock), key)

        after, record = jax.vmap(one)(states, keys)
        choose = functools.partial(jax.vmap(jnp.where), _going_on(scenario, states))
        return Batch(jax.tree.map(choose, after, states), clock + 1), record

    blank = jax.tree.map(
        lambda leaf: jnp.repeat(leaf[:, None], len(keys), axis=1),
        blank_records(controller, scenario.robot, capacity),
    )
    return loop(
        step, lambda batch: jnp.any(_going_on(scenario, batch.states)), batch, blank, num_steps
    )


@eqx.filter_jit
def _look(
    controller: Controller, scenario: Scenario, states: LoopState, keys: PRNGKeyArray
) -> Look:
    def one(state: LoopState, key: PRNGKeyArray) -> Look:
        return look_at(controller, scenario, state, key, 0)

    return jax.vmap(one)(states, keys)
