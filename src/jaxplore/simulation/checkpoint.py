"""The point where a run ended, from which `simulate` continues it."""

import dataclasses
import hashlib
import re
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxplore import _checks
from jaxplore._types import Key
from jaxplore.control.base import Controller
from jaxplore.report.recording import Frame, Recording
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.scenario import Scenario
from jaxplore.simulation.state import LoopState

_LOOP = "loop/"
_STATE = f"{_LOOP}state/"
_ADDRESS = re.compile(r" at 0x[0-9a-f]+")


@dataclasses.dataclass(frozen=True)
class Checkpoint:
    """What `simulate` needs to continue a run.

    `loop` is the part that is done, and the state at its end. Of a run that was loaded, the state
    is a tuple of the leaves of a `LoopState`, in NumPy. `key` is the data of the random key of the
    run. `controller` and `scenario` are digests. `datum` (2,) is that of the scenario [m].
    """

    loop: ChunkedRun[Any, Any, Frame]
    key: np.ndarray
    controller: str
    scenario: str
    datum: np.ndarray

    @classmethod
    def at_end_of(
        cls,
        loop: ChunkedRun[LoopState, Any, Frame],
        controller: Controller,
        scenario: Scenario,
        key: Key,
    ) -> "Checkpoint":
        """Return the checkpoint at the end of a run."""
        data, datum = np.asarray(jax.random.key_data(key)), scenario.datum.offset
        return cls(loop, data, digest(controller), digest(scenario), datum)

    @classmethod
    def from_arrays(
        cls, recording: Recording, arrays: Mapping[str, np.ndarray]
    ) -> "Checkpoint | None":
        """Return the checkpoint of a saved run from its `arrays`; None if saved without one."""
        if f"{_LOOP}key" not in arrays:
            return None
        number = sum(name.startswith(_STATE) for name in arrays)
        # Folders of former versions have none: they were written without one.
        datum = np.asarray(arrays.get(f"{_LOOP}datum", np.zeros(2)), np.float64).reshape(2)
        loop: ChunkedRun[Any, Any, Frame] = ChunkedRun(
            tuple(arrays[f"{_STATE}{i}"] for i in range(number)),
            # A recording is in the coordinates of the map, the loop is not.
            recording.move(-datum).records,
            recording.frames,
            recording.timing,
            recording.num_steps,
            recording.is_interrupted,
            _checks.positive_int("interval", arrays[f"{_LOOP}interval"].item()),
        )
        key, controller, scenario = (
            arrays[f"{_LOOP}{name}"] for name in ("key", "controller", "scenario")
        )
        return cls(loop, key, str(controller), str(scenario), datum)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what a run folder stores of the checkpoint beside the recording."""
        return {
            **{
                f"{_STATE}{i}": _data(leaf)
                for i, leaf in enumerate(jax.tree.leaves(self.loop.state))
            },
            f"{_LOOP}interval": np.asarray(self.loop.interval),
            f"{_LOOP}key": self.key,
            f"{_LOOP}controller": np.asarray(self.controller),
            f"{_LOOP}scenario": np.asarray(self.scenario),
            f"{_LOOP}datum": self.datum,
        }

    def state(self, scenario: Scenario, initial: LoopState) -> LoopState:
        """Return the state to continue from; a loaded one gets the structure of `initial`.

        Raises:
            ValueError: a state of other shapes than `initial`; a run that is finished.
        """
        state = self.loop.state
        if not isinstance(state, LoopState):
            state = _like(state, initial)
        if not bool(scenario.is_unfinished(state.task)):
            raise ValueError("resume is a finished run; accepted: one that is not finished")
        return state

    def check(self, controller: Controller, scenario: Scenario, key: Key, num_steps: int) -> None:
        """Check that a run with these arguments continues this one.

        Raises:
            ValueError: another controller, scenario or key than those of the run; a run that has as
                many steps already.
        """
        of_run = "that of the run to resume"
        for name, given, known in (
            ("controller", controller, self.controller),
            ("scenario", scenario, self.scenario),
        ):
            if digest(given) != known:
                raise ValueError(f"{name} differs from {of_run}; accepted: an equal {name}")
        data = np.asarray(jax.random.key_data(key))
        if not np.array_equal(data, self.key):
            raise ValueError(
                f"key has the data {data.tolist()}; accepted: {self.key.tolist()}, {of_run}"
            )
        _checks.whole_number("num_steps", num_steps, at_least=self.loop.num_steps + 1)


def _like(leaves: Sequence[np.ndarray], initial: LoopState) -> LoopState:
    """Return a state from the data of its leaves."""
    like, structure = jax.tree.flatten(initial)
    given, known = (
        [(each.shape, each.dtype) for each in some] for some in (leaves, map(_data, like))
    )
    if given != list(known):
        raise ValueError(
            "resume has a state of other shapes than that of the controller and the scenario; "
            "accepted: a run of these"
        )
    state: LoopState = jax.tree.unflatten(
        structure, [_leaf(each, one) for each, one in zip(leaves, like, strict=True)]
    )
    return state


def _data(leaf: Any) -> np.ndarray:
    """Return a leaf in NumPy; of a random key, its data."""
    is_key = isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
    return np.asarray(jax.random.key_data(leaf) if is_key else leaf)


def _leaf(data: np.ndarray, like: Any) -> jax.Array:
    if jnp.issubdtype(like.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(jnp.asarray(data), impl=jax.random.key_impl(like))
    return jnp.asarray(data)


def digest(tree: Any) -> str:
    """Return a text that is equal for equal controllers or scenarios, and only for them."""
    leaves, structure = jax.tree.flatten(tree)
    result = hashlib.sha256()
    # The structure names classes, sizes and static fields. Addresses of functions differ from
    # process to process.
    result.update(_ADDRESS.sub("", f"{type(tree)} {structure}").encode())
    for leaf in leaves:
        if isinstance(leaf, (jax.Array, np.ndarray)):
            array = _data(leaf)
            result.update(f"{array.shape} {array.dtype}".encode() + array.tobytes())
        else:
            result.update(_ADDRESS.sub("", repr(leaf)).encode())
    return result.hexdigest()
