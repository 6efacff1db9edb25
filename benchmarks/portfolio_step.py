"""A portfolio's step in the closed loop: what it costs, by number of members and by part."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from benchmarks.portfolio import ROLES, experiment
from benchmarks.tables import Rows
from benchmarks.timing import TimedLoop, percentiles, timed
from jaxplore.planning.presets.ground_vehicle import ROLE_WEIGHTS
from jaxplore.simulation.exploration.scenario import ExplorationScenario


class Sizes(NamedTuple):
    """Numbers of members, samples and horizon of each, steps, the number of members whose parts are
    timed, timed calls, the place, and steps of a chunk."""

    counts: tuple[int, ...] = (1, 2, 4, 8)
    samples: int = 1000
    horizon: int = 30
    steps: int = 2000
    parts_of: int = 4
    runs: int = 200
    place: str = "warehouse"
    chunk: int = 50


FULL = Sizes()
# The loop of the document on ground vehicles, which the suite compiles anyway.
SMOKE = Sizes((4,), 32, 30, 0, 4, 3, "small office", 4)
TITLES = {
    "members": "A portfolio's step in the warehouse by members: K = 1000, T = 30, 360 beams",
    "parts": "The same, part by part, four members",
}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return the times of the warehouse's step."""
    loops = {
        count: loop_of(count, sizes.samples, sizes.horizon, sizes.place, sizes.chunk)
        for count in sizes.counts
    }
    members = _members(loops, sizes.steps, sizes.chunk)
    return {"members": members, "parts": _parts(loops[sizes.parts_of], sizes.runs)}


def loop_of(
    count: int, samples: int, horizon: int, place: str = FULL.place, chunk: int = FULL.chunk
) -> TimedLoop:
    """Return the closed loop of a portfolio.

    Args:
        count: number of members.
        samples: number of samples of each.
        horizon: steps of each rollout.
        place: where it is.
        chunk: steps for which a call has room.
    """
    weights = {f"{ROLES[n % 4]} {n}": _weights(ROLES[n % 4]) for n in range(count)}
    changes = {"num_samples": samples, "horizon": horizon}
    made = experiment(place, {"weights": weights, **changes})
    return TimedLoop(made.controller, made.scenario, made.key, chunk)


def _members(loops: dict[int, TimedLoop], steps: int, chunk: int) -> Rows:
    """Return times of the step, everything in it, by number of members.

    The numbers take turns, so that all see the same noise of the machine.
    """
    seconds: dict[int, list[float]] = {count: [] for count in loops}
    for _ in range(-(-steps // chunk) + 1):
        for count, loop in loops.items():
            seconds[count].extend(loop.run(1) for _ in range(chunk))
    # The first chunk warms up, unless it is all there is.
    rows = [
        {"members": count, **percentiles(times[chunk:] or times)}
        for count, times in seconds.items()
    ]
    first = rows[0]["p50_ms"]
    return [{**row, "times one": row["p50_ms"] / first, "Hz": 1e3 / row["p50_ms"]} for row in rows]


def _parts(loop: TimedLoop, runs: int) -> Rows:
    """Return times of the parts of the warehouse's step, one call at a time."""
    controller, scenario, state, key = loop.controller, loop.scenario, loop.state, loop.key
    assert isinstance(scenario, ExplorationScenario)
    belief, pose = state.task.belief, state.task.belief.pose
    look = scenario.sensors[0], scenario.world, pose
    scan = eqx.filter_jit(lambda s, w, p: s.scan(w, p, key=key))(*look)
    elapsed = jnp.asarray(0.2)
    calls: dict[str, tuple[Any, ...]] = {
        "all members and their fusion": (
            lambda c, s, x, b: c.step(s, x, b, key=key)[:2],
            controller,
            state.controller,
            state.task.robot,
            belief,
        ),
        "scan": (lambda s, w, p: s.scan(w, p, key=key), *look),
        "map and clearance": (
            lambda p, b, x, at: p.observe(b, x, at),
            scenario.perception,
            belief,
            scan,
            pose,
        ),
        # As in `benchmarks.control_step`, of which it is the same program where sizes are equal.
        "fields": (scenario.perception.update_fields, belief, pose, elapsed),
    }
    return [{"": name, **timed(*call, runs=runs).row()} for name, call in calls.items()]


def _weights(role: str) -> dict[str, float]:
    return {name: weight for name, weight in ROLE_WEIGHTS[role].items() if name != "terrain"}
