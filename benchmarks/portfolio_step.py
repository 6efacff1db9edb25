"""A portfolio's step in the closed loop: what it costs, by number of members and by part."""

import time
from typing import Any, cast

import jax.numpy as jnp
import numpy as np

from benchmarks.portfolio import ROLES, experiment
from benchmarks.timing import timed
from jaxplore.planning.presets.ground_vehicle import ROLE_WEIGHTS
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.loop import initial_loop_state, run_chunk

CHUNK = 50


def measure(steps: int) -> dict[str, Any]:
    """Return the times of the warehouse's step: K = 1000, T = 30, 360 beams."""
    return {"members": step_times((1, 2, 4, 8), steps), "parts": parts()}


def step_times(counts: tuple[int, ...], steps: int) -> list[dict[str, Any]]:
    """Return times of the step, everything in it, by number of members.

    The numbers take turns, so that all see the same noise of the machine.
    """
    loops: dict[int, list[Any]] = {}
    for count in counts:
        weights = {f"{ROLES[n % 4]} {n}": _weights(ROLES[n % 4]) for n in range(count)}
        made = experiment("warehouse", {"weights": weights, "num_samples": 1000, "horizon": 30})
        controller = made.controller.at_period(made.scenario.control_period)
        state = initial_loop_state(controller, made.scenario, made.key)
        loops[count] = [controller, made.scenario, state, made.key]
    seconds: dict[int, list[float]] = {count: [] for count in counts}
    for _ in range(-(-steps // CHUNK) + 1):
        for count, loop in loops.items():
            controller, scenario, state, key = loop
            for _ in range(CHUNK):
                began = time.perf_counter()
                state, _, done = cast(Any, run_chunk)(
                    (controller, scenario, key, jnp.asarray(1, jnp.int32)), state, CHUNK
                )
                int(done)
                seconds[count].append(time.perf_counter() - began)
            loop[2] = state
    rows = []
    for count, times in seconds.items():
        p50, p99 = 1e3 * np.percentile(times[CHUNK:], [50, 99])
        rows.append({"members": count, "p50 ms": float(p50), "p99 ms": float(p99)})
    first = rows[0]["p50 ms"]
    return [{**row, "times one": row["p50 ms"] / first, "Hz": 1e3 / row["p50 ms"]} for row in rows]


def parts() -> list[dict[str, Any]]:
    """Return times of the parts of the warehouse's step, one call at a time, after 5 s."""
    controller, scenario, _, key = experiment("warehouse", {})
    assert isinstance(scenario, ExplorationScenario)
    controller = controller.at_period(scenario.control_period)
    state = initial_loop_state(controller, scenario, key)
    state, _, _ = run_chunk((controller, scenario, key, jnp.asarray(250, jnp.int32)), state, 250)
    belief, pose = state.task.belief, state.task.belief.pose
    scan = scenario.sensors[0].scan(scenario.world, pose, key=key)
    elapsed = jnp.asarray(0.2)
    calls: dict[str, tuple[Any, ...]] = {
        "all members and their fusion": (
            lambda c, s, x, b: c.step(s, x, b, key=key)[:2],
            controller,
            state.controller,
            state.task.robot,
            belief,
        ),
        "scan": (lambda s, w, p: s.scan(w, p, key=key), scenario.sensors[0], scenario.world, pose),
        "map and clearance": (
            lambda p, b, x, at: p.observe(b, x, at),
            scenario.perception,
            belief,
            scan,
            pose,
        ),
        "fields": (
            lambda p, b, at, t: p.update_fields(b, at, t),
            scenario.perception,
            belief,
            pose,
            elapsed,
        ),
    }
    rows = []
    for name, (function, *arguments) in calls.items():
        measured = timed(function, *arguments)
        rows.append({"": name, "p50 ms": measured.p50_ms, "p99 ms": measured.p99_ms})
    return rows


def _weights(role: str) -> dict[str, float]:
    return {name: weight for name, weight in ROLE_WEIGHTS[role].items() if name != "terrain"}
