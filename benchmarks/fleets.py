"""Fleets: time to coverage by size and coordination, contacts, and the cost of a control step."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.history import results_file
from benchmarks.setting import available_maps
from benchmarks.tables import table
from benchmarks.timing import TimedLoop
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.run import simulate
from jaxplore.tasks.registry import build, make_settings

SITES = {
    "nav2_warehouse": "nav2_warehouse/warehouse.yaml",
    "willow_garage_010": "willow_garage_010/willow-2010-02-18-0.10.yaml",
}
SIZES = (1, 2, 4, 8)
COORDINATIONS = ("claims", "assignment", "none")
CHUNK, TURNS = 50, 20
LIMIT = 1200.0
"""Simulated time after which a run ends [s]."""


def fleet(path: str, robots: int, coordination: str, seed: int, **changes: Any) -> Experiment:
    """Return the default fleet on a map.

    Args:
        path: name of a generated map, or file of a map.
        robots: number of robots.
        coordination: how they divide the places among themselves.
        seed: seed of the run.
        changes: further settings of the section `fleet`.
    """
    section = {"robots": robots, "coordination": coordination, **changes}
    entries = {"map": path, "fleet": section, "seed": seed, "time_limit": LIMIT}
    return build(make_settings(entries))


def measure(
    seeds: int,
    maps: Sequence[str] | None = None,
    sizes: Sequence[int] = SIZES,
    coordinations: Sequence[str] = COORDINATIONS,
    **changes: Any,
) -> list[dict[str, Any]]:
    """Return one row per map, size, coordination and seed; each is printed when it is done.

    Args:
        seeds: number of runs of each kind.
        maps: names of maps; all when absent.
        sizes: numbers of robots.
        coordinations: how they divide the places among themselves; one robot has nothing to divide.
        changes: further settings of the section `fleet`.
    """
    rows = []
    for name, path in available_maps(SITES).items():
        if maps is not None and name not in maps:
            continue
        for robots in sizes:
            for kind in coordinations if robots > 1 else ("none",):
                for seed in range(seeds):
                    rows.append(_row(name, path, robots, kind, seed, changes))
                    print(json.dumps(rows[-1]), flush=True)
    return rows


def _row(
    name: str, path: str, robots: int, kind: str, seed: int, changes: dict[str, Any]
) -> dict[str, Any]:
    controller, scenario, num_steps, key = fleet(path, robots, kind, seed, **changes)
    metrics: Any = simulate(controller, scenario, num_steps, key=key, num_trajectories=0).metrics
    team = metrics.parts["team"]
    return {
        "map": name,
        "robots": robots,
        "coordination": kind,
        "seed": seed,
        **{f"time_to_{level}": metrics.time_to[str(level)] for level in (50, 90, 95, 99)},
        "coverage": metrics.coverage,
        "contacts": team.contacts,
        "collisions": metrics.collisions,
        "minimum_clearance": metrics.minimum_clearance,
        "path_m": metrics.path_length,
        "exchanged_mb": 1e-6 * team.exchanged,
        "linked": team.linked,
        "loop_ms": metrics.compute.loop_step_ms,
    }


def summarise(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return medians over seeds for each kind of run, and the ratio to one robot's time to 90 %."""
    kinds = dict.fromkeys((row["map"], row["robots"], row["coordination"]) for row in rows)
    medians = {}
    for kind in kinds:
        chosen = [r for r in rows if (r["map"], r["robots"], r["coordination"]) == kind]
        medians[kind] = chosen, _median([row["time_to_90"] for row in chosen])
    summary = []
    for (name, robots, coordination), (chosen, to_90) in medians.items():
        alone = next((m for (n, r, _), (_, m) in medians.items() if n == name and r == 1), None)
        apart = medians.get((name, robots, "none"), (None, None))[1]
        summary.append(
            {
                "map": name,
                "robots": robots,
                "coordination": coordination,
                "seeds": len(chosen),
                "time_to_90_s": to_90,
                "of_one_robot": _ratio(to_90, alone),
                "of_no_coordination": _ratio(to_90, apart),
                "path_m": float(np.median([row["path_m"] for row in chosen])),
                "contacts": sum(row["contacts"] for row in chosen),
                "collisions": sum(row["collisions"] for row in chosen),
                "least_clearance_m": min(row["minimum_clearance"] for row in chosen),
                "exchanged_mb": float(np.median([row["exchanged_mb"] for row in chosen])),
                "linked": _median([row["linked"] for row in chosen]),
            }
        )
    return summary


def _median(values: Sequence[float | None]) -> float | None:
    """Return the median, in which a run that never got there counts as infinitely late."""
    found = float(np.median([np.inf if each is None else each for each in values]))
    return found if np.isfinite(found) else None


def _ratio(value: float | None, of: float | None) -> float | None:
    return None if value is None or of is None else value / of


def measure_step(robots: int = 4) -> dict[str, Any]:
    """Return the time of a control step of a fleet, and of one robot of the same kind.

    Both run on in turns, so that they see the same noise of the machine; the ratio is the median
    over the turns. The clocks of both begin with the run, so that the fleet includes exchanges.

    Args:
        robots: number of robots.
    """
    path = next(iter(available_maps(SITES).values()))
    loops = []
    for number in (1, robots):
        controller, scenario, _, key = fleet(path, number, "claims", 0)
        endless = eqx.tree_at(
            lambda each: each.explorations.kinds[0].target_coverage, scenario, jnp.asarray(1.0)
        )
        loops.append(TimedLoop(controller, endless, key, CHUNK))
    compile_seconds = [loop.run(0) for loop in loops]
    for loop in loops:
        loop.run(CHUNK)
    times = np.array([[loop.run(CHUNK) / CHUNK for loop in loops] for _ in range(TURNS)])
    alone, together = 1e3 * np.median(times, axis=0)
    return {
        "robots": robots,
        "device": jax.devices()[0].device_kind,
        "compile_s_alone": compile_seconds[0],
        "compile_s_fleet": compile_seconds[1],
        "step_ms_alone": float(alone),
        "step_ms_fleet": float(together),
        "ratio": float(np.median(times[:, 1] / times[:, 0])),
    }


@dataclasses.dataclass(frozen=True)
class _Choice:
    """What is measured, from the command line."""

    seeds: int
    maps: list[str] | None
    sizes: list[int]
    coordinations: list[str]
    out: Path | None
    step: bool


def _choice() -> _Choice:
    import argparse

    parser = argparse.ArgumentParser(prog="python -m benchmarks.fleets", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="runs of each kind [default: 20]")
    parser.add_argument(
        "--maps", nargs="*", choices=list(available_maps(SITES)), help="[default: all]"
    )
    parser.add_argument("--sizes", nargs="*", type=int, default=list(SIZES))
    parser.add_argument("--coordinations", nargs="*", default=list(COORDINATIONS))
    parser.add_argument("--out", type=results_file, help="JSON file of all rows and the summary")
    parser.add_argument("--step", action="store_true", help="only the cost of a control step")
    return _Choice(**vars(parser.parse_args()))


def main() -> None:
    """Measure what the command line asks for."""
    from rich.console import Console

    choice, console = _choice(), Console(width=180)
    results: dict[str, Any] = {"step": measure_step()} if choice.step else {}
    if choice.step:
        console.print(table("A control step of a fleet", [results["step"]]))
    else:
        rows = measure(choice.seeds, choice.maps, choice.sizes, choice.coordinations)
        results = {"runs": rows, "summary": summarise(rows)}
        console.print(table("Fleets, medians over seeds", results["summary"]))
    if choice.out is not None:
        choice.out.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
