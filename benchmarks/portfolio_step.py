"""A portfolio's step in the closed loop: what it costs, by number of members and by part."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from benchmarks.portfolio import ROLES, experiment
from benchmarks.timing import TimedLoop, timed
from jaxplore.planning.presets.ground_vehicle import ROLE_WEIGHTS
from jaxplore.simulation.exploration.scenario import ExplorationScenario

CHUNK = 50


def measure(steps: int) -> dict[str, Any]:
    """Return the times of the warehouse's step: K = 1000, T = 30, 360 beams."""
    return {"members": step_times((1, 2, 4, 8), steps), "parts": parts()}


def step_times(counts: tuple[int, ...], steps: int) -> list[dict[str, Any]]:
    """Return times of the step, everything in it, by number of members.

    The numbers take turns, so that all see the same noise of the machine.
    """
    loops: dict[int, TimedLoop] = {}
    for count in counts:
        weights = {f"{ROLES[n % 4]} {n}": _weights(ROLES[n % 4]) for n in range(count)}
        made = experiment("warehouse", {"weights": weights, "num_samples": 1000, "horizon": 30})
        loops[count] = TimedLoop(made.controller, made.scenario, made.key, CHUNK)
    seconds: dict[int, list[float]] = {count: [] for count in counts}
    for _ in range(-(-steps // CHUNK) + 1):
        for count, loop in loops.items():
            seconds[count].extend(loop.run(1) for _ in range(CHUNK))
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
    loop = TimedLoop(controller, scenario, key, 250)
    loop.run(250)
    controller, state = loop.controller, loop.state
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
