"""Whole runs: does the robot see everything, how far does it drive, does it touch anything."""

from typing import Any

import numpy as np

from benchmarks.setting import available_sites, experiment
from jaxplore.simulation.run import simulate


def measure(seeds: int) -> list[dict[str, Any]]:
    """Return one row per map and seed."""
    rows = []
    for site in available_sites():
        for seed in range(seeds):
            controller, scenario, num_steps, key = experiment(site, seed)
            metrics = simulate(controller, scenario, num_steps, key=key).metrics
            rows.append({"map": site.name, **metrics.as_dict()})
            rows[-1].pop("coverage_curve")
    return rows


def summarise(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return medians over the seeds of each map, and the worst of what must not happen."""
    summary = []
    for name in dict.fromkeys(row["map"] for row in rows):
        chosen = [row for row in rows if row["map"] == name]

        def median(key: str, level: str, of: list[dict[str, Any]] = chosen) -> float | None:
            values = [row[key][level] for row in of]
            return None if None in values else float(np.median(values))

        summary.append(
            {
                "map": name,
                "seeds": len(chosen),
                "least_coverage": min(row["coverage"] for row in chosen),
                "collisions": sum(row["collisions"] for row in chosen),
                "least_clearance_m": min(row["minimum_clearance"] for row in chosen),
                "longest_stall_s": max(row["longest_stall"] for row in chosen),
                **{f"time_to_{level}_s": median("time_to", level) for level in ("90", "95", "99")},
                **{f"path_to_{level}_m": median("path_to", level) for level in ("90", "95", "99")},
            }
        )
    return summary
