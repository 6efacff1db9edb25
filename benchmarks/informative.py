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

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.informative_peer import Peer, PeerError
from benchmarks.timing import timed
from jaxplore.build.tasks import build, make_settings
from jaxplore.planning import InformativeMPPI
from jaxplore.simulation.loop import initial_loop_state, run_chunk
from jaxplore.simulation.state import LoopState

ARCHITECTURES = ("two-layer", "parallel")
CHUNK = 25
TURNS, TURN_STEPS = 3, 200
LONGEST_FLIGHT = 500


def measure() -> dict[str, Any]:
    """Return the times of both architectures and of the peer, and ratios."""
    compile_seconds = {name: _compile_seconds_elsewhere(name) for name in ARCHITECTURES}
    loops = {name: _Loop(name) for name in ARCHITECTURES}
    with tempfile.TemporaryDirectory() as folder:
        about, theirs = _take_turns(loops, Path(folder))
    rows = [
        {"": name, "library": "jaxplore", **loop.times.row(), "compile_seconds": spent}
        for (name, loop), spent in zip(loops.items(), compile_seconds.values(), strict=True)
    ]
    reason = about.get("reason")
    name = "parallel" if reason is None else f"parallel, does not run: {reason}"
    spent = about.get("compile_seconds")
    rows.append({"": name, "library": "jax_mppi", **theirs.row(), "compile_seconds": spent})
    controller, world = loops["parallel"].controller, loops["parallel"].scenario.world
    return {
        "samples": controller.mppi.num_samples,
        "horizon": controller.mppi.horizon,
        "cells": list(world.shape),
        "peer": about,
        "loop": rows,
        "ratios": _ratios(*rows),
        "parts": _parts(loops),
    }


def _take_turns(loops: dict[str, "_Loop"], folder: Path) -> tuple[dict[str, Any], "_Times"]:
    """Let ours and the peer take turns; return what the peer says of itself, and its times."""
    try:
        peer = Peer(folder, TURN_STEPS)
        theirs = _Times()
        for _ in range(TURNS):
            for loop in loops.values():
                loop.turn()
            theirs.add(peer.turn())
        peer.close()
    except PeerError as error:
        print(f"jax_mppi's simulation does not run: {error}", file=sys.stderr)
        for loop in loops.values():
            while len(loop.times.means) < TURNS:
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
        return {**row, "loop_mean_ms": float(np.median(self.means)) if self.means else None}


class _Loop:
    """The closed loop of an architecture."""

    def __init__(self, architecture: str) -> None:
        self.controller, self.scenario, self.num_steps, self.key = _experiment(architecture)
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
        while single < TURN_STEPS:
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
        result = run_chunk((self.controller, self.scenario, key, count), state, CHUNK)
        jax.block_until_ready(result)  # type: ignore[no-untyped-call]
        return result[0], time.perf_counter() - began, int(result[2])


def _experiment(architecture: str) -> tuple[InformativeMPPI, Any, int, jax.Array]:
    settings = make_settings({"map": "zones", "architecture": architecture})
    controller, scenario, num_steps, key = build(settings)
    controller = controller.at_period(scenario.control_period)
    assert isinstance(controller, InformativeMPPI)
    return controller, scenario, num_steps, key


def _parts(loops: dict[str, _Loop]) -> list[dict[str, Any]]:
    """The strategic layer, short looks and MPPI alone, two seconds into a flight."""
    rows: dict[str, dict[str, Any]] = {}
    for architecture, loop in loops.items():
        controller, state = loop.controller, loop.after(100)
        belief, robot = state.task.belief, state.task.robot
        at = controller.mppi.dynamics.position(robot)
        prepare = eqx.filter_jit(lambda c, *given: c._prepare(*given))
        mppi, known, strategy, _ = prepare(controller, state.controller, robot, belief)
        parts: dict[str, Any] = {
            "information field around the robot": timed(
                controller.potential_sensor.field, belief.grid, at
            ),
            "reference": None,
            "strategy: field and reference": timed(controller.strategic_plan, belief, robot),
            "short-range field": timed(
                controller.short_range_field, belief, controller.sensor_model, at
            ),
            "MPPI": timed(
                lambda mppi, *given: mppi.step(*given[:3], key=given[3]),
                *(mppi, state.controller.mppi, robot, known, loop.key),
            ),
        }
        if controller.reference is not None:
            start = jnp.append(at, controller.altitude)
            parts["reference"] = timed(controller.reference, belief, strategy.best, start)
        prefix = architecture.replace("-", "_")
        for name, part in parts.items():
            row = rows.setdefault(name, {"": name})
            row[f"{prefix}_p50_ms"] = None if part is None else part.p50_ms
            row[f"{prefix}_p99_ms"] = None if part is None else part.p99_ms
    return list(rows.values())


def _ratios(
    two_layer: dict[str, Any], parallel: dict[str, Any], peer: dict[str, Any]
) -> list[dict[str, Any]]:
    """How many times as long the peer takes, for all that both have."""
    ours = {"two_layer": two_layer, "parallel": parallel}
    return [
        {
            "": f"jax_mppi, {name}",
            **{f"times_as_long_as_{key}": theirs / row[name] for key, row in ours.items()},
        }
        for name, theirs in peer.items()
        if isinstance(theirs, float)
    ]


def _compile_seconds_elsewhere(architecture: str) -> float:
    """Return what a new process takes until the loop is ready for its first step [s]."""
    command = [sys.executable, "-m", "benchmarks.informative", architecture]
    environment = {**os.environ, "JAX_ENABLE_COMPILATION_CACHE": "false"}
    folder = Path(__file__).parents[1]
    done = subprocess.run(
        command, stdout=subprocess.PIPE, text=True, check=True, env=environment, cwd=folder
    )
    return float(done.stdout.splitlines()[-1])


def _compile_seconds(architecture: str) -> float:
    controller, scenario, _, key = _experiment(architecture)
    jax.block_until_ready((controller, scenario, key))  # type: ignore[no-untyped-call]
    began = time.perf_counter()
    state, program = initial_loop_state(controller, scenario, key), cast(Any, run_chunk)
    program.lower((controller, scenario, key, jnp.asarray(0)), state, CHUNK).compile()
    return time.perf_counter() - began


if __name__ == "__main__":
    print(_compile_seconds(sys.argv[1]))
