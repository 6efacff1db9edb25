"""Informative MPPI in its closed loop, its parts, and jax_mppi's parallel informative simulation.

Ours is `jaxplore run zones` with its defaults, as the two-layer and as the parallel architecture:
K = 1000, T = 40, a quadrotor with 24 beams, a field of 20 x 20 nodes and 8 yaws. A control step is
everything: a scan and the map at 50 Hz, the fields of the whole map and the strategy at 5 Hz, MPPI,
the move, the collision check, the record. Flights take turns: one is flown step by step, each step
waited for and timed, and again in chunks of 25 steps, which return to Python 1 time in 25. Both run
the very program that `simulate` runs. A flight that is over is followed by one with another key.

- `cached_step`: neither strategy nor fields are due; `strategy_step`: the strategy is;
  `fields_step`: the fields of the whole map are, which the peer has no counterpart of. In a
  flight's first step all are: it counts in the percentiles of all steps only.
- `loop_mean_ms`: of a step in chunks, the median over turns.
- `compile_seconds`: the first state, lowering and compiling the loop, in a process of its own,
  without a cache on disk. Imports and reading the settings are not in it.

The peer is jax_mppi's own script with its own numbers, see `peers/jax_mppi_informative.py`. It
takes turns with ours, so that both see the same noise of the machine. Its K, T, field (12 beams of
10 m, 20 x 20 nodes, 8 yaws, every 10th step), cells and scans (24 beams of 4 m) are those that ours
has as defaults. It calls itself parallel, and tracks a reference up the field as our two-layer
architecture does. What is to its disadvantage, or neither:

- Its environment is an office of its own, not the three zones. Its times depend on sizes only.
- It casts short looks for each sample at each step of the horizon; ours reads a map of them.
- Its simulation computes one field more, at its start: 1 in 21 of what is in its `loop_mean_ms`.

And where it favours the peer: its robot senses in the map that it believes in, there is no true
world; nothing checks collisions; no distances to obstacles, no guidance through the whole map and
no coverage are computed; its progress bar is off.
"""

import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.informative_peer import Peer, PeerError
from benchmarks.tables import Rows
from benchmarks.timing import measure_cases, percentiles, timed
from jaxplore.maps.world import three_zones
from jaxplore.planning import InformativeMPPI, ReferenceStart
from jaxplore.simulation.loop import initial_loop_state, run_chunk
from jaxplore.simulation.state import LoopState
from jaxplore.tasks.registry import build, make_settings

ARCHITECTURES = ("two-layer", "parallel")
CHUNK = 25
LONGEST_FLIGHT = 500


class Sizes(NamedTuple):
    """Changes of the settings, turns and their steps, steps of a flight before its parts are timed,
    calls of a part, the architectures of which the compilation is timed and whether each has a
    process, and steps for which a call of the loop has room."""

    changes: Mapping[str, Any] = {}
    architectures: tuple[str, ...] = ARCHITECTURES
    turns: int = 3
    steps: int = 200
    flown: int = 100
    runs: int = 200
    compiled: tuple[str, ...] = ARCHITECTURES
    are_apart: bool = True
    capacity: int = CHUNK


FULL = Sizes()
# The loop of `tests/planning/test_architectures.py`, which the suite compiles anyway.
SMOKE = Sizes(
    {
        "world": {**three_zones().to_dict(), "resolution": 0.2},
        "lidar": {"num_beams": 36, "max_range": 3.0, "range_noise": 0.0},
        "fields": {"num_directions": 8},
        "rates": {"control": 20.0, "sensing": 10.0, "fields": 5.0},
        "informative": {
            "num_samples": 64,
            "horizon": 10,
            "field_beams": 4,
            "field_range": 3.0,
            "field_noise": 0.0,
            "field_spacing": 0.8,
            "field_extent": 3.2,
            "local_beams": 4,
            "local_range": 1.5,
        },
        "guard": False,
        "time_limit": 0.5,
    },
    architectures=("two-layer",),
    turns=1,
    steps=CHUNK,
    flown=0,
    runs=3,
    compiled=("two-layer",),
    are_apart=False,
    capacity=50,
)
TITLES = {
    "loop": "Informative MPPI, a control step of the closed loop: K = 1000, T = 40",
    "ratios": "The same, times as long as jaxplore",
    "parts": "Informative MPPI, part by part",
}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return the times of both architectures and of the peer, and ratios."""
    # Programs are compiled anew: what an earlier run has left on the disk does not count.
    uncached = {"JAX_ENABLE_COMPILATION_CACHE": "false"}
    cases = [(name, sizes.changes, sizes.capacity) for name in sizes.compiled]
    compiled = measure_cases(
        measure_compilation, cases, are_apart=sizes.are_apart, environment=uncached
    )
    spent = {row["architecture"]: row["compile_seconds"] for row in compiled}
    loops = {name: _Loop(name, sizes) for name in sizes.architectures}
    with tempfile.TemporaryDirectory() as folder:
        about, theirs = _take_turns(loops, Path(folder), sizes)
    rows = [
        {"": name, "library": "jaxplore", **loop.times.row(), "compile_seconds": spent.get(name)}
        for name, loop in loops.items()
    ]
    reason = about.get("reason")
    name = "parallel" if reason is None else f"parallel, does not run: {reason}"
    peer = {"compile_seconds": about.get("compile_seconds")}
    rows.append({"": name, "library": "jax_mppi", **theirs.row(), **peer})
    return {"loop": rows, "ratios": _ratios(*rows), "parts": _parts(loops, sizes)}


def _take_turns(
    loops: dict[str, "_Loop"], folder: Path, sizes: Sizes
) -> tuple[dict[str, Any], "_Times"]:
    """Let ours and the peer take turns; return what the peer says of itself, and its times."""
    try:
        peer = Peer(folder, sizes.steps)
        theirs = _Times()
        for _ in range(sizes.turns):
            for loop in loops.values():
                loop.turn()
            theirs.add(peer.turn())
        peer.close()
    except PeerError as error:
        print(f"jax_mppi's simulation does not run: {error}", file=sys.stderr)
        for loop in loops.values():
            while len(loop.times.means) < sizes.turns:
                loop.turn()
        return {"reason": str(error)}, _Times()
    return peer.about, theirs


class _Times:
    """Single steps by kind [ms], and means over uninterrupted loops [ms], one a turn."""

    def __init__(self) -> None:
        self.single: list[tuple[str, float]] = []
        self.means: list[float] = []

    def add(self, turn: dict[str, Any]) -> None:
        self.single += [("strategy" if due else "cached", ms) for due, ms in turn["single"]]
        self.means.append(turn["loop_mean_ms"])

    def row(self) -> dict[str, Any]:
        row: dict[str, Any] = {"steps": len(self.single)}
        for kind, levels in (
            ("", (50, 90, 99)),
            ("cached", (50, 99)),
            ("strategy", (50, 99)),
            ("fields", (50, 99)),
        ):
            chosen = [ms for name, ms in self.single if kind in ("", name)]
            for level in levels:
                name = f"{kind}_step_p{level}_ms".removeprefix("_step_")
                row[name] = float(np.percentile(chosen, level)) if chosen else None
        all_steps = [1e-3 * ms for _, ms in self.single]
        return {
            **row,
            "loop_mean_ms": float(np.median(self.means)) if self.means else None,
            "repeats": percentiles(all_steps)["repeats"] if all_steps else [],
        }


class _Loop:
    """The closed loop of an architecture."""

    def __init__(self, architecture: str, sizes: Sizes) -> None:
        made = _experiment(architecture, sizes.changes)
        self.controller, self.scenario, self.num_steps, self.key = made
        self.steps, self.capacity = sizes.steps, sizes.capacity
        self.every = int(self.scenario.steps_per_field)
        self.times, self.flights = _Times(), 0
        self._chunk(self.begin(), self.key, 0)

    def begin(self) -> LoopState:
        state: LoopState = initial_loop_state(self.controller, self.scenario, jax.random.key(0))
        return state

    def turn(self) -> None:
        """Fly, each flight in single steps and in chunks."""
        for _ in range(2):  # What ran before has cooled what is warmed up here.
            self._chunk(self.begin(), self.key, CHUNK)
        single, seconds, steps = 0, 0.0, 0
        while single < self.steps:
            key = jax.random.fold_in(self.key, self.flights)
            self.flights += 1
            flown = self._fly(key, 1)
            self.times.single += [(self._kind(step), 1e3 * took) for step, took, _ in flown]
            single += len(flown)
            flown = self._fly(key, CHUNK)
            seconds += sum(took for _, took, _ in flown)
            steps += sum(done for _, _, done in flown)
        self.times.means.append(1e3 * seconds / steps)

    def after(self, steps: int) -> LoopState:
        """Return the state in a flight."""
        state = self.begin()
        for _ in range(steps // CHUNK):
            state, _, _ = self._chunk(state, self.key, CHUNK)
        return state

    def _kind(self, step: int) -> str:
        phases = {0: "strategy", self.every - 1: "fields"}
        return "first" if step == 0 else phases.get(step % self.every, "cached")

    def _fly(self, key: jax.Array, size: int) -> list[tuple[int, float, int]]:
        """Return for each call: the steps before it, how long it took [s], the steps it did."""
        state, flown, step = self.begin(), [], 0
        while step < min(self.num_steps, LONGEST_FLIGHT):
            state, took, done = self._chunk(state, key, size)
            if done > 0:
                flown.append((step, took, done))
            step += done
            if done < size:
                break
        return flown

    def _chunk(self, state: LoopState, key: jax.Array, size: int) -> tuple[LoopState, float, int]:
        count = jnp.asarray(size)
        jax.block_until_ready((state, key, count))  # type: ignore[no-untyped-call]
        began = time.perf_counter()
        result = run_chunk((self.controller, self.scenario, key, count), state, self.capacity)
        jax.block_until_ready(result)  # type: ignore[no-untyped-call]
        return result[0], time.perf_counter() - began, int(result[2])


def _experiment(
    architecture: str, changes: Mapping[str, Any]
) -> tuple[InformativeMPPI, Any, int, jax.Array]:
    settings = make_settings({"map": "zones", "architecture": architecture, **changes})
    controller, scenario, num_steps, key = build(settings)
    controller = controller.at_period(scenario.control_period)
    assert isinstance(controller, InformativeMPPI)
    return controller, scenario, num_steps, key


def _parts(loops: dict[str, _Loop], sizes: Sizes) -> Rows:
    """The strategic layer, short looks and MPPI alone, two seconds into a flight."""
    rows: dict[str, dict[str, Any]] = {}
    for architecture, loop in loops.items():
        controller, state = loop.controller, loop.after(sizes.flown)
        belief, robot = state.task.belief, state.task.robot
        model = controller.mppi.dynamics
        at = model.position(robot)
        prepare = eqx.filter_jit(lambda c, *given: c._prepare(*given))
        mppi, known, strategy, _ = prepare(controller, state.controller, robot, belief)
        parts: dict[str, tuple[Any, ...] | None] = {
            "information field around the robot": (
                controller.potential_sensor.field,
                *(belief.grid, at),
            ),
            "reference": None,
            "strategy: field and reference": (controller.strategic_plan, belief, robot),
            "short-range field": (
                controller.short_range_field,
                *(belief, controller.sensor_model, at),
            ),
            "MPPI": (
                lambda mppi, *given: mppi.step(*given[:3], key=given[3]),
                *(mppi, state.controller.mppi, robot, known, loop.key),
            ),
        }
        if controller.reference is not None:
            place = jnp.append(at, controller.altitude)
            start = ReferenceStart(place, model.heading(robot), model.speed(robot))
            parts["reference"] = (controller.reference, belief, strategy.best, start)
        prefix = architecture.replace("-", "_")
        for name, given in parts.items():
            row = rows.setdefault(name, {"": name})
            part = None if given is None else timed(*given, runs=sizes.runs).row()
            row[f"{prefix}_p50_ms"] = None if part is None else part["p50_ms"]
            row[f"{prefix}_p99_ms"] = None if part is None else part["p99_ms"]
    return list(rows.values())


def _ratios(*rows: dict[str, Any]) -> Rows:
    """How many times as long the peer, the last row, takes, for all that both have."""
    *ours, peer = rows
    return [
        {
            "": f"jax_mppi, {name}",
            **{f"times_as_long_as_{row['']}": theirs / row[name] for row in ours},
        }
        for name, theirs in peer.items()
        if isinstance(theirs, float) and all(isinstance(row[name], float) for row in ours)
    ]


def measure_compilation(
    architecture: str, changes: Mapping[str, Any], capacity: int
) -> dict[str, Any]:
    """Return what a new process takes until the loop is ready for its first step [s]."""
    controller, scenario, _, key = _experiment(architecture, changes)
    jax.block_until_ready((controller, scenario, key))  # type: ignore[no-untyped-call]
    began = time.perf_counter()
    state, program = initial_loop_state(controller, scenario, key), cast(Any, run_chunk)
    program.lower((controller, scenario, key, jnp.asarray(0)), state, capacity).compile()
    return {"architecture": architecture, "compile_seconds": time.perf_counter() - began}
