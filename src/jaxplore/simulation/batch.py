"""Batches of runs in one compiled loop, with different keys, parameters, or both."""

import functools
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool
from jaxtyping import Key as KeyArray

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_STEPS
from jaxplore._types import Count, Flag, Key
from jaxplore.control.base import Controller
from jaxplore.report.recording import Frame, Recording
from jaxplore.simulation.chunks import CHUNK_SECONDS, FRAME_SECONDS, ChunkedRun, loop, run_in_chunks
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.loop import (
    closed_loop_step,
    copy_tree,
    frame_arrays,
    initial_loop_state,
)
from jaxplore.simulation.scenario import Scenario
from jaxplore.simulation.stacking import LeafMask, Stacked
from jaxplore.simulation.state import LoopState

Keys = KeyArray[Array, "..."]
"""Random keys (B,) of the runs, or one key for all."""


class RunBatch(NamedTuple):
    """Loop states of a batch of runs, with a leading axis of runs; each counts its own steps.

    `clock` is the number of steps of the unfinished runs. It is one number for all runs, so that a
    batch senses and derives fields only as often as a single run.
    """

    states: LoopState
    clock: Count


@_kinds.check_arguments
def record_runs(
    controller: Controller,
    scenario: Scenario,
    num_steps: int,
    *,
    keys: Keys,
) -> tuple[Recording, ...]:
    """Simulate a batch of runs by `jax.vmap`, each until it is finished or the steps are done.

    Batches are for accelerators. One run keeps a CPU busy: there a batch takes longer than its runs
    one after the other. Each run equals that of `record_run` with the same key up to rounding,
    whose effect grows with time; the same keys give the same runs. The frames show no plans, and
    the times are those of the steps of all runs together.

    Ctrl-C ends all runs after the current chunk and returns them.

    Args:
        controller: computes the controls.
        scenario: the task.
        num_steps: greatest number of control periods.
        keys: (B,) random keys, one for each run.

    Raises:
        ValueError: fewer than one step; no keys.
    """
    _kinds.key("keys", keys, ndim=1)
    if not len(keys):
        raise ValueError(f"keys has shape {keys.shape}; accepted: (B,), one for each run")
    experiments = [Experiment(controller, scenario, num_steps, key) for key in keys]
    runs, _ = record_experiments(experiments, num_steps)
    return runs


def record_experiments(
    experiments: Sequence[Experiment],
    num_steps: int,
    *,
    with_frames: bool = True,
    differs: LeafMask | None = None,
) -> tuple[tuple[Recording, ...], LeafMask]:
    """Simulate a batch of runs that differ in keys and in parameters of controllers and scenarios.

    See `record_runs`. Values that all runs share, such as maps and noise of the same key, are
    computed once. The experiments' own numbers of steps are ignored. The result is the recordings,
    and a mask of the arrays that differed. A later call that is given the mask as `differs` treats
    these arrays as different even if they are equal there, so both calls share a compiled program.

    Raises:
        ValueError: fewer than one step; no experiments, or some that differ in more than numbers.
    """
    limit = _checks.positive_int("num_steps", num_steps, at_most=MOST_STEPS)
    if not experiments:
        raise ValueError("experiments is empty; accepted: at least one")
    began = time.perf_counter()
    pairs = [
        (one.controller.at_period(one.scenario.control_period), one.scenario.for_batches())
        for one in experiments
    ]
    stacked = Stacked.from_trees(pairs, differs, name="experiments")
    keys = jnp.stack([one.key for one in experiments])
    data = jax.random.key_data(keys)
    if len(experiments) > 1 and bool(jnp.all(data == data[:1])):
        # With a single key for all runs, vmap draws the random numbers once.
        keys = keys[0]
    scenario = experiments[0].scenario
    chunk = max(1, round(CHUNK_SECONDS / scenario.period))
    before = _begin(stacked, keys, len(experiments))

    def run(batch: RunBatch, steps: Count) -> tuple[RunBatch, Any, Count]:
        return _run_chunk((stacked, keys, steps), batch, chunk)

    def frames(batch: RunBatch, step: int) -> tuple[Frame, ...]:
        if not with_frames:
            return ()
        arrays = jax.tree.map(np.asarray, _frames(stacked, batch.states, keys))
        steps = np.asarray(batch.states.step).tolist()
        return tuple(
            one.scenario.make_frame(done, _run_at(arrays, i))
            for i, (one, done) in enumerate(zip(experiments, steps, strict=True))
        )

    every = scenario.steps_per_revision

    def revise(batch: RunBatch) -> RunBatch:
        runs = (_run_at(batch.states, i) for i in range(len(experiments)))
        unfinished = np.asarray(_are_unfinished(stacked, batch.states))
        alone = [
            one.scenario.update_on_host(state) if is_left else state
            for one, state, is_left in zip(experiments, runs, unfinished, strict=True)
        ]
        return batch._replace(states=jax.tree.map(lambda *each: jnp.stack(each), *alone))

    together = run_in_chunks(
        run,
        lambda batch: jnp.any(_are_unfinished(stacked, batch.states)),
        frames,
        copy_tree(before),
        began=began,
        limit=limit,
        chunk=chunk,
        interval=max(1, round(FRAME_SECONDS / scenario.period)),
        on_chunk=lambda _: chunk,
        revise=revise if every else None,
        revise_every=every or 0,
    )
    recordings = tuple(
        scenario.recording(controller, _run_at(before.states, i).task, _extract_run(together, i))
        for i, (controller, scenario) in enumerate(pairs)
    )
    return recordings, stacked.differs


def _run_at[T](together: T, i: int) -> T:
    """Return one run's entry of arrays with a leading axis of runs."""
    alone: T = jax.tree.map(lambda leaf: leaf[i], together)
    return alone


def _extract_run(
    together: ChunkedRun[RunBatch, Any, tuple[Frame, ...]], i: int
) -> ChunkedRun[LoopState, Any, Frame]:
    """Extract one of the runs, as if it had been simulated alone."""
    state = _run_at(together.state.states, i)
    num_steps = int(state.step)
    # The frames after its end are all equal.
    frames = {frames[i].step: frames[i] for frames in together.frames if frames}
    return ChunkedRun(
        state,
        jax.tree.map(lambda leaf: leaf[:num_steps, i], together.records),
        tuple(frames.values()),
        together.timing,
        num_steps,
        together.is_interrupted,
    )


def _key_axis(keys: Keys) -> int | None:
    return None if keys.ndim == 0 else 0


@eqx.filter_jit
def _begin(stacked: Stacked, keys: Keys, size: int) -> RunBatch:
    def one(arrays: tuple[Array, ...], key: Key) -> LoopState:
        controller, scenario = stacked.tree(arrays)
        return initial_loop_state(controller, scenario, key)

    axes = (stacked.axes, _key_axis(keys))
    states = jax.vmap(one, in_axes=axes, axis_size=size)(stacked.arrays, keys)
    return RunBatch(states, jnp.zeros((), jnp.int32))


@eqx.filter_jit
def _are_unfinished(stacked: Stacked, states: LoopState) -> Bool[Array, " B"]:
    def one(arrays: tuple[Array, ...], state: LoopState) -> Flag:
        scenario: Scenario = stacked.tree(arrays)[1]
        return scenario.is_unfinished(state.task)

    return jax.vmap(one, in_axes=(stacked.axes, 0))(stacked.arrays, states)


@eqx.filter_jit(donate="all-except-first")
def _run_chunk(
    given: tuple[Stacked, Keys, Count], batch: RunBatch, capacity: int
) -> tuple[RunBatch, Any, Count]:
    """Run a number of steps, fewer if all runs are finished; see `run_chunk`."""
    stacked, keys, num_steps = given
    axes = (stacked.axes, 0, _key_axis(keys))

    def step(batch: RunBatch) -> tuple[RunBatch, Any]:
        states, clock = batch

        def one(arrays: tuple[Array, ...], state: LoopState, key: Key) -> tuple[LoopState, Any]:
            controller, scenario = stacked.tree(arrays)
            # The shared clock has no axis of runs, so `when_due` stays a branch under vmap.
            return closed_loop_step(controller, scenario, state._replace(step=clock), key)

        after, record = jax.vmap(one, in_axes=axes)(stacked.arrays, states, keys)
        # A finished run keeps its state while the others continue.
        choose = functools.partial(jax.vmap(jnp.where), _are_unfinished(stacked, states))
        return RunBatch(jax.tree.map(choose, after, states), clock + 1), record

    size = batch.states.step.shape[0]
    # All runs have records of the same shape, so those of the first one stand for all.
    controller, scenario = stacked.at(0)
    first = _run_at(batch.states, 0)
    blank = jax.tree.map(
        lambda leaf: jnp.repeat(leaf[:, None], size, axis=1),
        scenario.blank_records(first.task, controller, capacity),
    )
    return loop(
        step, lambda batch: jnp.any(_are_unfinished(stacked, batch.states)), batch, blank, num_steps
    )


@eqx.filter_jit
def _frames(stacked: Stacked, states: LoopState, keys: Keys) -> dict[str, Any]:
    def one(arrays: tuple[Array, ...], state: LoopState, key: Key) -> dict[str, Any]:
        controller, scenario = stacked.tree(arrays)
        return frame_arrays(controller, scenario, state, key, 0)

    axes = (stacked.axes, 0, _key_axis(keys))
    return jax.vmap(one, in_axes=axes)(stacked.arrays, states, keys)
