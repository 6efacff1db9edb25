"""Portfolios of ground vehicles: against their members, in their scenarios, methods by fusions.

The comparisons are hours of runs. Each run is one line of a file, written when it is done; what is
there already is not run again, so the work can be stopped and shared among processes:

    python -m benchmarks.portfolio --out runs.jsonl --part 0/2 &
    python -m benchmarks.portfolio --out runs.jsonl --part 1/2

A run's numbers but for its compute do not depend on the machine's load.
"""

import argparse
import fcntl
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from benchmarks.history import results_file
from benchmarks.setting import MAPS
from benchmarks.tables import table
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.run import record_run
from jaxplore.tasks.exploration.settings import read_settings, scenario_path
from jaxplore.tasks.registry import build, make_settings

ROLES = ("explorer", "balanced", "exploiter", "cautious")
FUSIONS = ("weighted-vote", "best-only", "average", "median", "trust-weighted", "contextual")
METHODS = {"MPPI": "direct", "smooth": "smooth", "kernel": "knots"}
STUDIES = ("members", "missions", "goals", "cross")
CROSSED = "aws_small_warehouse_005"
"""Where methods are crossed with members and fusions: runs there are short."""

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
    "small office": {
        "map": "office",
        "office": {"width": 8.0, "height": 7.0},
        "architecture": "portfolio",
        "lidar": {"num_beams": 60, "max_range": 4.0},
        "guard": False,
    },
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
                mixed = {"fusion": fusion, "is_safe": False, "parameterisation": method}
                yield CROSSED, f"{label}: {fusion}", mixed
            yield CROSSED, f"{label}: safe {FUSIONS[0]}", {"parameterisation": method}


def experiment(place: str, changes: dict[str, Any]) -> Experiment:
    """Return what is run."""
    entries = PLACES[place] or read_settings(scenario_path(place))
    merged = {**entries, "portfolio": {**entries.get("portfolio", {}), **changes}}
    return build(make_settings(merged))


def run(case: Case) -> dict[str, Any]:
    """Return what came of one run."""
    controller, scenario, num_steps, _ = experiment(case.place, case.changes)
    assert isinstance(scenario, ExplorationScenario)
    recording = record_run(
        controller, scenario, num_steps, key=jax.random.key(case.seed), num_trajectories=0
    )
    metrics = recording.metrics(seed=case.seed)
    kept = metrics.as_dict()
    for name in ("coverage_curve", "versions"):
        kept.pop(name)
    start = np.asarray(scenario.start[:2])
    distance = None if scenario.goal is None else float(np.hypot(*(scenario.goal.position - start)))
    return {**case._asdict(), "start_goal_distance": distance, "metrics": kept}


def summarise(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row for each variant: medians over seeds, sums of collisions."""
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["study"], row["place"], row["variant"]), []).append(row)
    summary = []
    for (study, place, variant), members in sorted(groups.items()):
        found = [row["metrics"] for row in members]

        def late(name: str, found: list[dict[str, Any]] = found) -> float | None:
            times = [each["time_to"][name] for each in found]
            middle = float(np.median([np.inf if time is None else time for time in times]))
            return middle if np.isfinite(middle) else None

        def median(name: str, found: list[dict[str, Any]] = found) -> float | None:
            values = [each[name] for each in found if each[name] is not None]
            return float(np.median(values)) if values else None

        def idle(found: list[dict[str, Any]] = found) -> float | None:
            values = [each["watch"]["mean_idleness"] for each in found if "watch" in each]
            return float(np.median(values)) if values else None

        summary.append(
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
                "targets": "/".join(
                    str(sum(e["targets"][name] for e in found if "targets" in e))
                    for name in ("seen", "number")
                ),
                "untraversable": sum(each["untraversable_steps"] for each in found),
                "idle [s]": idle(found),
                "diversity": median("diversity"),
                "replaced": median("replaced"),
            }
        )
    return summary


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw every run of the members' study, and the medians of the cross by method."""
    places = list(PLACES)[:2]
    figure = Figure(figsize=(13.0, 4.4), layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.2))
    for axis, place in zip(axes[:2], places, strict=True):
        found = [row for row in rows if (row["study"], row["place"]) == ("members", place)]
        variants = [name for _, name, _ in _variants("members")][: 1 + len(ROLES)][::-1]
        for level, variant in enumerate(variants):
            chosen = [row["metrics"] for row in found if row["variant"] == variant]
            for share, colour, shift in (("90", "#1f6fb4", 0.13), ("95", "#e07b1a", -0.13)):
                # One that never gets there has no dot, and still counts for the median.
                reached = [run["time_to"][share] for run in chosen]
                times = [np.inf if time is None else time for time in reached]
                axis.plot(times, [level + shift] * len(times), "o", color=colour, ms=4, alpha=0.45)
                axis.plot(np.median(times), level + shift, "|", color=colour, ms=18, mew=2.5)
        axis.set_yticks(range(len(variants)), variants)
        axis.set(xlabel="time to 90 % (upper) and 95 % (lower) coverage [s]", title=place)
    medians = [row for row in summarise(rows) if row["study"] == "cross"]
    for (label, _), marker in zip(METHODS.items(), "osD", strict=True):
        of_method = [row for row in medians if row["variant"].startswith(label)]
        for kind, colour in (("one member", "#8a8f98"), ("fused", "#1f6fb4"), ("safe", "#c8323c")):
            chosen = [row for row in of_method if _kind(row["variant"]) == kind]
            axes[2].plot(
                [row["to 95 % [s]"] for row in chosen],
                [row["jerk"] for row in chosen],
                marker,
                color=colour,
                label=f"{label}, {kind}",
            )
    axes[2].set(xlabel="time to 95 % coverage [s]", ylabel="jerk [1/s²]", title=f"on {CROSSED}")
    axes[2].set_ylim(bottom=0.0)
    axes[2].legend(fontsize="small")
    figure.savefig(path, dpi=110)


def _kind(variant: str) -> str:
    name = variant.partition(": ")[2]
    return "one member" if name in ROLES else "safe" if name.startswith("safe") else "fused"


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
    parser.add_argument("--out", type=results_file, default=Path("benchmarks/portfolio.jsonl"))
    parser.add_argument("--picture", type=Path, help="draw what is in the file")
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
    rows = read_rows(arguments.out)
    if rows:
        console.print(table("Portfolios, medians over seeds", summarise(rows)))
    if arguments.picture is not None:
        draw(rows, arguments.picture)


if __name__ == "__main__":
    main()
