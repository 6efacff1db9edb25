"""Portfolios of ground vehicles: against their members, in their scenarios, and what they cost.

The comparisons are hours of runs. Each run is one line of a file, written when it is done; what is
there already is not run again, so the work can be stopped and shared among processes:

    python -m benchmarks.portfolio --out runs.jsonl --part 0/2 &
    python -m benchmarks.portfolio --out runs.jsonl --part 1/2

A run's numbers but for its compute do not depend on the machine's load.
"""

import argparse
import fcntl
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.setting import MAPS
from benchmarks.timing import timed
from jaxplore.experiment.assembly import Experiment, build
from jaxplore.planning.ground_vehicle import ROLE_WEIGHTS
from jaxplore.report.metrics import compute_metrics
from jaxplore.settings import make_settings, read_settings, scenario_path
from jaxplore.simulation.closed_loop import initial_loop_state, run_chunk
from jaxplore.simulation.simulate import record_run

ROLES = ("explorer", "balanced", "exploiter", "cautious")
FUSIONS = ("weighted-vote", "best-only", "average", "median", "trust-weighted", "contextual")
METHODS = {"MPPI": "direct", "smooth": "smooth", "kernel": "knots"}
STUDIES = ("members", "missions", "goals", "cross")
CROSSED = "aws_small_warehouse_005"
"""Where methods are crossed with members and fusions: runs there are short."""
CHUNK = 50

PLACES: dict[str, dict[str, Any]] = {
    "warehouse": {},
    "aws_small_warehouse_005": {
        "map": str(MAPS / "aws_small_warehouse_005" / "map.yaml"),
        "start": [-0.92, -2.47, 0.0],
        "architecture": "portfolio",
        "target_coverage": 0.95,
        "time_limit": 240.0,
    },
    "search-rescue": {},
    "perimeter": {},
    "nav2_depot to goal": {
        "map": str(MAPS / "nav2_depot" / "depot.yaml"),
        "start": [4.62, 7.73, 0.0],
        "goal": [27.9, 14.1],
        "architecture": "portfolio",
        "time_limit": 120.0,
    },
    "aws_small_house to goal": {
        "map": str(MAPS / "aws_small_house" / "map.yaml"),
        "start": [4.68, -1.97, 0.0],
        "goal": [-7.9, -2.9],
        "architecture": "portfolio",
        "time_limit": 120.0,
    },
}


class Case(NamedTuple):
    """One run."""

    study: str
    place: str
    variant: str
    changes: dict[str, Any]
    seed: int

    @property
    def name(self) -> str:
        """What tells it from all others."""
        return f"{self.study}/{self.place}/{self.variant}/{self.seed}"


def cases(study: str, seeds: int) -> Iterator[Case]:
    """Yield the runs of a study, seed by seed."""
    for seed in range(seeds):
        for place, variant, changes in _variants(study):
            yield Case(study, place, variant, changes, seed)


def _variants(study: str) -> Iterator[tuple[str, str, dict[str, Any]]]:
    if study == "members":
        for place in ("warehouse", "aws_small_warehouse_005"):
            yield place, "portfolio, safe fusion", {}
            for role in ROLES:
                yield place, role, {"members": [role]}
    elif study == "missions":
        for place in ("search-rescue", "perimeter"):
            yield place, "portfolio, safe fusion", {}
    elif study == "goals":
        for place in ("nav2_depot to goal", "aws_small_house to goal"):
            yield place, "portfolio, safe fusion", {}
    else:
        for label, method in METHODS.items():
            for role in ROLES:
                changes = {"members": [role], "parameterisation": method}
                yield CROSSED, f"{label}: {role}", changes
            for fusion in FUSIONS:
                changes = {"fusion": fusion, "is_safe": False, "parameterisation": method}
                yield CROSSED, f"{label}: {fusion}", changes
            yield CROSSED, f"{label}: safe {FUSIONS[0]}", {"parameterisation": method}


def experiment(place: str, changes: dict[str, Any]) -> Experiment:
    """Return what is run."""
    entries = PLACES[place] or read_settings(scenario_path(place))
    merged = {**entries, "portfolio": {**entries.get("portfolio", {}), **changes}}
    return build(make_settings(merged))


def run(case: Case) -> dict[str, Any]:
    """Return what came of one run."""
    controller, scenario, num_steps, _ = experiment(case.place, case.changes)
    recording = record_run(
        controller, scenario, num_steps, key=jax.random.key(case.seed), num_trajectories=0
    )
    metrics = compute_metrics(recording, seed=case.seed)
    kept = metrics.as_dict()
    for name in ("coverage_curve", "versions"):
        kept.pop(name)
    start = np.asarray(scenario.start[:2])
    distance = None if scenario.goal is None else float(np.hypot(*(scenario.goal - start)))
    return {**case._asdict(), "start_goal_distance": distance, "metrics": kept}


def step_times(counts: tuple[int, ...] = (1, 2, 4, 8), steps: int = 1000) -> list[dict[str, Any]]:
    """Return times of the warehouse's control step, everything in it, by number of members.

    K = 1000, T = 30, 360 beams: as in the scenario. The numbers take turns, so that all see the
    same noise of the machine.
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
                    controller, scenario, state, key, jnp.asarray(1, jnp.int32), CHUNK
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
    controller = controller.at_period(scenario.control_period)
    state = initial_loop_state(controller, scenario, key)
    state, _, _ = run_chunk(controller, scenario, state, key, jnp.asarray(250, jnp.int32), 250)
    belief, pose = state.belief, state.belief.pose
    scan = scenario.sensors[0].scan(scenario.world, pose, key=key)
    elapsed = jnp.asarray(0.2)
    calls: dict[str, tuple[Any, ...]] = {
        "all members and their fusion": (
            lambda c, s, x, b: c.step(s, x, b, key=key)[:2],
            controller,
            state.controller,
            state.robot,
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


def summarise(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row for each variant: medians over seeds, sums of collisions."""
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["study"], row["place"], row["variant"]), []).append(row)
    table = []
    for (study, place, variant), members in sorted(groups.items()):
        found = [row["metrics"] for row in members]

        def late(name: str, found: list[dict[str, Any]] = found) -> float | None:
            times = [each["time_to"][name] for each in found]
            middle = float(np.median([np.inf if time is None else time for time in times]))
            return middle if np.isfinite(middle) else None

        def median(name: str, found: list[dict[str, Any]] = found) -> float | None:
            values = [each[name] for each in found if each[name] is not None]
            return float(np.median(values)) if values else None

        table.append(
            {
                "study": study,
                "place": place,
                "variant": variant,
                "seeds": len(found),
                "to 90 % [s]": late("90"),
                "to 95 % [s]": late("95"),
                "finished": sum(each["is_finished"] for each in found),
                "path [m]": median("path_length"),
                "collisions": sum(each["collisions"] for each in found),
                "clearance [m]": min(each["minimum_clearance"] for each in found),
                "jerk": median("command_jerk"),
                "goal distance [m]": median("goal_distance"),
                "targets": f"{sum(e['targets_seen'] for e in found)}"
                f"/{sum(e['num_targets'] for e in found)}",
                "untraversable": sum(each["untraversable_steps"] for each in found),
                "idle [s]": median("mean_idleness"),
                "diversity": median("diversity"),
                "replaced": median("replaced"),
            }
        )
    return table


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the runs in a file, none if it is not there."""
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def main() -> None:
    """Run what is missing, then print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.portfolio")
    parser.add_argument("--study", choices=STUDIES, help="this one only [default: all]")
    parser.add_argument("--seeds", type=int, default=20, help="of each [default: 20; cross: 5]")
    parser.add_argument("--part", default="0/1", help="this process's share [default: 0/1]")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/portfolio.jsonl"))
    parser.add_argument("--times", action="store_true", help="time the step and its parts as well")
    arguments = parser.parse_args()
    part, of = (int(number) for number in arguments.part.split("/"))
    console = Console(width=220)
    wanted = [
        case
        for study in STUDIES
        if arguments.study in (None, study)
        for case in cases(study, min(5, arguments.seeds) if study == "cross" else arguments.seeds)
    ]
    for number, case in enumerate(wanted):
        done = read_rows(arguments.out)
        names = {Case(*[row[field] for field in Case._fields]).name for row in done}
        if number % of != part or case.name in names:
            continue
        console.print(f"{number + 1} of {len(wanted)}: {case.name}")
        row = run(case)
        with arguments.out.open("a", encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            file.write(json.dumps(row, allow_nan=False) + "\n")
    _print(console, summarise(read_rows(arguments.out)))
    if arguments.times:
        _print(console, step_times())
        _print(console, parts())


def _print(console: Console, rows: list[dict[str, Any]]) -> None:
    if not rows:
        return
    table = Table(*rows[0])
    for row in rows:
        cells = (row[name] for name in rows[0])
        table.add_row(
            *(
                f"{cell:.2f}" if isinstance(cell, float) else "-" if cell is None else str(cell)
                for cell in cells
            )
        )
    console.print(table)


def _weights(role: str) -> dict[str, float]:
    return {name: weight for name, weight in ROLE_WEIGHTS[role].items() if name != "terrain"}


if __name__ == "__main__":
    main()
