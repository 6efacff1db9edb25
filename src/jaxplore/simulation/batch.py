"""Runs side by side in one compiled loop: with other keys, other numbers, or both."""

import functools
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, PRNGKeyArray

from jaxplore import _checks
from jaxplore._types import Count, Flag, Key
from jaxplore.control.base import Controller
from jaxplore.simulation.chunks import CHUNK_SECONDS, Watched, loop, watch
from jaxplore.simulation.exploration.closed_loop import (
    LoopState,
    closed_loop_step,
    initial_loop_state,
    is_unfinished,
)
from jaxplore.simulation.exploration.record import Record, blank_records
from jaxplore.simulation.exploration.scenario import Scenario
from jaxplore.simulation.following.follow import PathRecording, path_recording_of
from jaxplore.simulation.following.path_loop import (
    PathLoopState,
    PathRecord,
    blank_path_records,
    initial_path_state,
    is_on_the_way,
    path_step,
)
from jaxplore.simulation.following.scenario import PathScenario
from jaxplore.simulation.recording import Frame, Recording
from jaxplore.simulation.simulate import (
    Look,
    frame_of,
    look_at,
    recording_of,
)


class Member(NamedTuple):
    """One of the runs of a batch: what `record_run` or `record_path_run` take."""

    controller: Controller
    scenario: Scenario | PathScenario
    key: Key


type Places = tuple[bool, ...]
"""Which arrays of the controller and scenario, in the order of their leaves, differ."""


class Stacked(eqx.Module):
    """Several pytrees of the same structure as one: what is the same in all is there once.

    So costs that are weighed differently still read the same map, and not one map each.

    Args:
        arrays: leaves, with a leading axis where `differs`.
        differs: which do; static.
        rest: what is no array; static.
    """

    arrays: tuple[Array, ...]
    differs: Places = eqx.field(static=True)
    structure: Any = eqx.field(static=True)
    rest: Any

    @classmethod
    def of(cls, trees: Sequence[Any], differs: Places | None = None) -> "Stacked":
        """Return pytrees as one.

        Args:
            trees: at least one.
            differs: leaves that are to be stacked though they may be the same here, so that the
                same compiled program serves.

        Raises:
            ValueError: pytrees that differ in more than the values of their arrays.
        """
        split = [eqx.partition(tree, eqx.is_array) for tree in trees]
        flat: list[tuple[list[Array], Any]] = [jax.tree.flatten(arrays) for arrays, _ in split]
        first, structure = flat[0]
        rest = split[0][1]
        shapes = [(leaf.shape, leaf.dtype) for leaf in first]
        for (leaves, kind), (_, other) in zip(flat, split, strict=True):
            same = kind == structure and shapes == [(leaf.shape, leaf.dtype) for leaf in leaves]
            if not same or not bool(eqx.tree_equal(other, rest)):
                raise ValueError(
                    "members differ in more than numbers; accepted: the same parts, with the same "
                    "sizes"
                )
        columns = list(zip(*(leaves for leaves, _ in flat), strict=True))
        given = differs or (False,) * len(columns)
        found = tuple(
            is_given or any(not _is_same(column[0], each) for each in column[1:])
            for is_given, column in zip(given, columns, strict=True)
        )
        arrays = tuple(
            jnp.stack(column) if is_stacked else column[0]
            for is_stacked, column in zip(found, columns, strict=True)
        )
        return cls(arrays, found, structure, rest)

    @property
    def axes(self) -> tuple[int | None, ...]:
        """Of `arrays`, for `jax.vmap`."""
        return tuple(0 if is_stacked else None for is_stacked in self.differs)

    def tree(self, arrays: Sequence[Array]) -> Any:
        """Return one of the pytrees from its arrays."""
        return eqx.combine(jax.tree.unflatten(self.structure, arrays), self.rest)

    def at(self, i: int) -> Any:
        """Return one of the pytrees."""
        return self.tree(
            [
                leaf[i] if is_stacked else leaf
                for leaf, is_stacked in zip(self.arrays, self.differs, strict=True)
            ]
        )


def _is_same(one: Array, other: Array) -> bool:
    return one is other or np.array_equal(np.asarray(one), np.asarray(other), equal_nan=True)


class Batch(NamedTuple):
    """Runs at the same time.

    Args:
        states: with a leading axis of runs; each knows its own steps.
        clock: steps that those have done that go on. It is the same for all, which so sense and
            derive no more often than one does.
    """

    states: Any
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
    if keys.ndim != 1 or not len(keys):
        raise ValueError(f"keys has shape {keys.shape}; accepted: (B,), one for each run")
    members = [Member(controller, scenario, key) for key in keys]
    runs, _ = record_members(members, num_steps)
    assert all(isinstance(run, Recording) for run in runs)
    return runs  # type: ignore[return-value]


def record_members(
    members: Sequence[Member],
    num_steps: int,
    *,
    with_frames: bool = True,
    differs: Places | None = None,
) -> tuple[tuple[Recording | PathRecording, ...], Places]:
    """Simulate runs that differ in keys and in numbers of their controllers and scenarios.

    As `record_runs`. What all members share, maps and noise of the same key, is computed once.

    Args:
        members: at least one, all along paths or none.
        num_steps: at most, in control periods.
        with_frames: whether to look at the runs; never along a path.
        differs: arrays to take for different though they may be the same here, as returned by a
            former call: then the same compiled program serves.

    Returns:
        The runs, and which arrays differed.

    Raises:
        ValueError: a number of steps < 1; no members, or such as differ in more than numbers.
    """
    limit = _checks.positive_int("num_steps", num_steps)
    if not members:
        raise ValueError("members is empty; accepted: at least one")
    began = time.perf_counter()
    pairs = [
        (one.controller.at_period(one.scenario.control_period), _for_batches(one.scenario))
        for one in members
    ]
    period = round(float(members[0].scenario.control_period), 7)
    stacked = Stacked.of(pairs, differs)
    keys = jnp.stack([one.key for one in members])
    shares_key = len(members) > 1 and bool(
        jnp.all(jax.random.key_data(keys) == jax.random.key_data(keys[:1]))
    )
    if shares_key:
        keys = keys[0]
    chunk = max(1, round(CHUNK_SECONDS / period))
    size = len(members)
    before = _begin(stacked, keys, size)

    def run(batch: Batch, steps: Count) -> tuple[Batch, Any, Count]:
        return _run_chunk(stacked, batch, keys, steps, chunk)

    def look(batch: Batch, step: int) -> tuple[Frame, ...]:
        if not with_frames or isinstance(members[0].scenario, PathScenario):
            return ()
        seen = jax.tree.map(np.asarray, _look(stacked, batch.states, keys))
        steps = np.asarray(batch.states.step).tolist()
        return tuple(
            frame_of(_of_run(seen, i), done, done * period) for i, done in enumerate(steps)
        )

    together = watch(
        run,
        lambda batch: jnp.any(_going_on(stacked, batch.states)),
        look,
        before,
        began=began,
        limit=limit,
        chunk=chunk,
        on_chunk=lambda *_: None,
    )
    runs: list[Recording | PathRecording] = []
    for i, (controller, scenario) in enumerate(pairs):
        alone = _alone(together, i)
        if isinstance(scenario, PathScenario):
            start = _of_run(before.states, i)
            runs.append(path_recording_of(scenario, start, alone))
        else:
            runs.append(recording_of(controller, scenario, _of_run(before.states, i), alone))
    return tuple(runs), stacked.differs


def _for_batches(scenario: Scenario | PathScenario) -> Scenario | PathScenario:
    if isinstance(scenario, PathScenario):
        return scenario
    same: Scenario = eqx.tree_at(
        lambda at: at.perception, scenario, scenario.perception.for_batches()
    )
    return same


def _of_run[T](together: T, i: int) -> T:
    """Return what is one run's of arrays with a leading axis of runs."""
    alone: T = jax.tree.map(lambda leaf: leaf[i], together)
    return alone


def _alone(together: Watched[Batch, Any, tuple[Frame, ...]], i: int) -> Watched[Any, Any, Any]:
    """Return one of the runs as if it had been alone."""
    state = _of_run(together.state.states, i)
    num_steps = int(state.step)
    # Those after its end are all the same.
    frames = {frames[i].step: frames[i] for frames in together.frames if frames}
    return Watched(
        state,
        jax.tree.map(lambda leaf: leaf[:num_steps, i], together.records),
        tuple(frames.values()),
        together.timing,
        num_steps,
        together.is_interrupted,
    )


def _begun(pair: Any, key: Key) -> LoopState | PathLoopState:
    controller, scenario = pair
    if isinstance(scenario, PathScenario):
        return initial_path_state(controller, scenario)
    return initial_loop_state(controller, scenario, key)


def _unfinished(pair: Any, state: Any) -> Flag:
    _, scenario = pair
    if isinstance(scenario, PathScenario):
        return is_on_the_way(scenario, state)
    return is_unfinished(scenario, state)


def _stepped(pair: Any, state: Any, key: Key) -> tuple[Any, Record | PathRecord]:
    controller, scenario = pair
    if isinstance(scenario, PathScenario):
        return path_step(controller, scenario, state, key)
    return closed_loop_step(controller, scenario, state, key)


def _blank(pair: Any, capacity: int) -> Record | PathRecord:
    controller, scenario = pair
    if isinstance(scenario, PathScenario):
        return blank_path_records(scenario, capacity)
    return blank_records(controller, scenario.robot, capacity)


def _key_axis(keys: PRNGKeyArray) -> int | None:
    # One key for all: what is drawn from it is drawn once.
    return None if keys.ndim == 0 else 0


@eqx.filter_jit
def _begin(stacked: Stacked, keys: PRNGKeyArray, size: int) -> Batch:
    def one(arrays: tuple[Array, ...], key: PRNGKeyArray) -> Any:
        return _begun(stacked.tree(arrays), key)

    axes = (stacked.axes, _key_axis(keys))
    return Batch(
        jax.vmap(one, in_axes=axes, axis_size=size)(stacked.arrays, keys), jnp.zeros((), jnp.int32)
    )


@eqx.filter_jit
def _going_on(stacked: Stacked, states: Any) -> Bool[Array, " B"]:
    def one(arrays: tuple[Array, ...], state: Any) -> Flag:
        return _unfinished(stacked.tree(arrays), state)

    return jax.vmap(one, in_axes=(stacked.axes, 0))(stacked.arrays, states)


@eqx.filter_jit
def _run_chunk(
    stacked: Stacked,
    batch: Batch,
    keys: PRNGKeyArray,
    num_steps: Count,
    capacity: int,
) -> tuple[Batch, Any, Count]:
    """Run up to `num_steps` steps, fewer if all runs are finished; see `run_chunk`."""
    axes = (stacked.axes, 0, _key_axis(keys))

    def step(batch: Batch) -> tuple[Batch, Any]:
        states, clock = batch

        def one(arrays: tuple[Array, ...], state: Any, key: PRNGKeyArray) -> tuple[Any, Any]:
            return _stepped(stacked.tree(arrays), state._replace(step=clock), key)

        after, record = jax.vmap(one, in_axes=axes)(stacked.arrays, states, keys)
        choose = functools.partial(jax.vmap(jnp.where), _going_on(stacked, states))
        return Batch(jax.tree.map(choose, after, states), clock + 1), record

    size = jax.tree.leaves(batch.states)[0].shape[0]
    blank = jax.tree.map(
        lambda leaf: jnp.repeat(leaf[:, None], size, axis=1), _blank(stacked.at(0), capacity)
    )
    return loop(
        step, lambda batch: jnp.any(_going_on(stacked, batch.states)), batch, blank, num_steps
    )


@eqx.filter_jit
def _look(stacked: Stacked, states: Any, keys: PRNGKeyArray) -> Look:
    def one(arrays: tuple[Array, ...], state: Any, key: PRNGKeyArray) -> Look:
        controller, scenario = stacked.tree(arrays)
        return look_at(controller, scenario, state, key, 0)

    axes = (stacked.axes, 0, _key_axis(keys))
    return jax.vmap(one, in_axes=axes)(stacked.arrays, states, keys)
