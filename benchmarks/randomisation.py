"""Settings that were tuned for the model against settings that were tuned for robots that vary.

Both searches have the same parameters, candidates and first candidate, the shipped settings. All
are then judged by the same robots, which no search has seen: the true robot of each run is drawn
from `VARIATION`, and the controller plans with the model.
"""

from pathlib import Path
from typing import Any

import numpy as np

from jaxplore.report.statistics import paired_difference, tail_mean
from jaxplore.study.tuning import Episode, Objective, Result, SettingsEpisodes, tune

VARIATION: dict[str, Any] = {
    "gain": [0.5, 1.0],
    "slip": [0.0, 0.3],
    "turn_slip": [0.0, 0.4],
    "control_delay": [0, 8],
    "control_noise": [0.0, 0.1],
    "position_noise": [0.0, 0.05],
    "heading_noise": [0.0, 0.05],
}
"""Actuators at 50 to 100 %, tyres that slip, 0 to 160 ms of delay, and noise."""
FAST: dict[str, Any] = {
    "path": "track",
    "robot": {"max_speed": 8.0},
    "controller": {"num_samples": 128},
    "time_limit": 40.0,
}
TUNED = (
    "controller.corridor_margin=0:0.4",
    "controller.noise_share=0.03:0.3:log",
    "controller.progress_weight=50:2000:log",
    "controller.comfort_weight=0.3:30:log",
)
SUM = "finished_at + 10*corridor_violations"
LEVEL = 0.8
SEARCHES = {
    "nominal": (FAST, SUM, 2),
    "robust": ({**FAST, "variation": VARIATION}, f"cvar({LEVEL}, {SUM})", 5),
}
CANDIDATES = 12
UNSEEN = range(1000, 1020)


def measure(folder: Path | None = None, candidates: int = CANDIDATES) -> list[dict[str, Any]]:
    """Return a row for each settings: its values, and what they reach with unseen robots.

    Args:
        folder: folder for the studies, from which an interrupted call continues; none when absent.
        candidates: candidates of each search.
    """
    judges = {
        "nominal": SettingsEpisodes({"run": FAST}),
        "varied": SettingsEpisodes({"run": {**FAST, "variation": VARIATION}}),
    }
    names = [each.partition("=")[0] for each in TUNED]
    chosen: dict[str, dict[str, Any]] = {
        "shipped": {name: judges["varied"].start(name) for name in names}
    }
    for title, (entries, minimized, number) in SEARCHES.items():
        found = tune(
            SettingsEpisodes({"run": entries}),
            TUNED,
            minimized,
            budget=candidates,
            seeds=number,
            unseen=1,
            animation=False,
            folder=None if folder is None else folder / title.replace(", ", "-"),
        )
        chosen[title] = dict(found.chosen.candidate)
    rows: list[dict[str, Any]] = []
    reference: list[float] | None = None
    for title, values in chosen.items():
        row: dict[str, Any] = {"settings": title, **values}
        for kind, episodes in judges.items():
            seeds = UNSEEN if kind == "varied" else UNSEEN[:5]
            metrics = _metrics(episodes, values, seeds)
            objective = Objective.parse(SUM)
            costs = [objective.value(each) for each in metrics]
            row[f"{kind} mean"] = float(np.mean(costs))
            row[f"{kind} CVaR"] = float(tail_mean(np.array(costs), LEVEL))
            row[f"{kind} out"] = sum(bool(each["corridor_violations"]) for each in metrics)
            row[f"{kind} late"] = sum(not each["is_finished"] for each in metrics)
            row[f"{kind} runs"] = len(metrics)
            if kind == "varied":
                reference = costs if title == "nominal" else reference
                if reference is not None:
                    row["CVaR against nominal"] = list(
                        paired_difference(reference, costs, level=LEVEL)
                    )
        rows.append(row)
    return rows


def _metrics(
    episodes: SettingsEpisodes, values: dict[str, Any], seeds: range
) -> list[dict[str, float | None]]:
    found: dict[int, dict[str, float | None]] = {}

    def keep(episode: Episode, result: Result) -> None:
        if result.error is not None:
            raise RuntimeError(result.error)
        found[episode.seed] = result.metrics

    episodes.run([Episode(0, values, "run", seed) for seed in seeds], keep)
    return [found[seed] for seed in seeds]
