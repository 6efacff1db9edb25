"""Horizons that adapt to speed, clearance or information, against fixed ones, on paired seeds."""

import statistics
import time
from typing import Any

import jax

from jaxplore.control.adaptive_horizon import (
    AdaptiveHorizon,
    HorizonByClearance,
    HorizonByInformation,
    HorizonBySpeed,
    HorizonRule,
)
from jaxplore.control.mppi import MPPI
from jaxplore.report.statistics import paired_difference
from jaxplore.study.experiments import record_alone
from jaxplore.tasks.registry import build, find_kind, make_settings

SHORT, USUAL, LONG = 20, 40, 60
RULES: dict[str, HorizonRule] = {
    "by speed": HorizonBySpeed(0.2, 0.9),
    "by clearance": HorizonByClearance(0.4, 1.2),
    "by information": HorizonByInformation(0.05, 0.0),
}


def measure(maps: dict[str, dict[str, Any]], seeds: int = 5) -> list[dict[str, Any]]:
    """Return a row for each map and horizon.

    Args:
        maps: settings of an exploration by name.
        seeds: number of runs of each.
    """
    rows = []
    for place, entries in maps.items():
        reference: list[float] = []
        for title in (str(USUAL), str(SHORT), str(LONG), *RULES):
            row = {"map": place, "horizon": title, **_runs(entries, title, seeds)}
            ends = row.pop("ends")
            reference = reference or ends
            row["against"] = [round(each, 2) for each in paired_difference(reference, ends)]
            rows.append(row)
            print(row, flush=True)
    return rows


def _runs(entries: dict[str, Any], title: str, seeds: int) -> dict[str, Any]:
    horizon = int(title) if title.isdigit() else LONG
    given = {**entries, "controller": {**entries.get("controller", {}), "horizon": horizon}}
    experiment = build(make_settings(find_kind(given).with_start(given)))
    if title in RULES:
        assert isinstance(experiment.controller, MPPI)
        adaptive = AdaptiveHorizon(experiment.controller, RULES[title], SHORT)
        experiment = experiment._replace(controller=adaptive)
    ends, contacts, walls = [], 0, []
    for seed in range(seeds):
        began = time.process_time()
        recording = record_alone(experiment._replace(key=jax.random.key(seed)))
        metrics: Any = recording.metrics(seed=seed)
        limit = float(entries["time_limit"])
        ends.append(limit if metrics.finished_at is None else float(metrics.finished_at))
        contacts += int(metrics.collisions)
        walls.append(1e3 * (time.process_time() - began) / recording.num_steps)
    # The first run compiles.
    return {
        "end_s": statistics.fmean(ends),
        "contacts": contacts,
        "cpu_ms_per_step": statistics.median(walls[1:]),
        "ends": ends,
    }
