"""Whole runs: does the robot see everything, how far does it drive, does it touch anything."""

from typing import Any, NamedTuple

import numpy as np

from benchmarks.setting import SMALL, SMALL_OFFICE, Site, available_sites, experiment
from benchmarks.tables import Rows
from jaxplore.simulation.run import simulate


class Sizes(NamedTuple):
    """Seeds, sites, and changes of the default explorer."""

    seeds: int = 3
    sites: tuple[Site, ...] = available_sites()
    changes: dict[str, Any] = {}  # noqa: RUF012


FULL = Sizes()
SMOKE = Sizes(1, (SMALL_OFFICE,), SMALL)
TITLES = {"summary": "Exploration, medians over seeds"}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return one row per map and seed, and their summary."""
    rows = []
    for site in sizes.sites:
        for seed in range(sizes.seeds):
            controller, scenario, num_steps, key = experiment(site, seed, **sizes.changes)
            metrics = simulate(controller, scenario, num_steps, key=key).metrics
            rows.append({"map": site.name, "seed": seed, **metrics.as_dict()})
            for name in ("coverage_curve", "versions"):
                rows[-1].pop(name)
    return {"summary": _summary(rows), "runs": rows}


def _summary(rows: Rows) -> Rows:
    """Return medians over the seeds of each map, and the worst of what must not happen."""
    summary = []
    for name in dict.fromkeys(row["map"] for row in rows):
        chosen = [row for row in rows if row["map"] == name]

        def median(key: str, level: str, of: Rows = chosen) -> float | None:
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
