"""What each setting does: a run's time to the end with a quarter and four times its default.

One setting at a time, the others as they are, with the same seeds for all. A run that does not get
to the end counts as in `jaxplore.study.tuning`: as late as the time limit, and later the more was
missing.
"""

import statistics
from typing import Any, NamedTuple

from benchmarks.tables import Rows
from jaxplore.study.tuning import Episode, Objective, Result, SettingsEpisodes

OBJECTIVE = Objective.parse("finished_at")
SMALL_OFFICE = {
    "map": "office",
    "office": {"width": 12.0, "height": 8.0},
    "rates": {"control": 20.0},
    "controller": {"num_samples": 500},
    "time_limit": 120.0,
    # Its default depends on the side of a cell, so that there would be no number to scale.
    "fields": {"min_information": 10.0},
}
Places = dict[str, tuple[dict[str, Any], tuple[str, ...]]]
PLACES: Places = {
    "path": (
        {"path": "track", "time_limit": 40.0},
        (
            "controller.temperature",
            "controller.noise_share",
            "controller.progress_weight",
            "controller.contouring_weight",
            "controller.lag_weight",
            "controller.comfort_weight",
            "controller.horizon",
            "controller.num_samples",
        ),
    ),
    "office": (
        SMALL_OFFICE,
        (
            "controller.temperature",
            "proposal.noise_std",
            "controller.guidance_weight",
            "controller.information_weight",
            "controller.obstacle_weight",
            "controller.horizon",
            "controller.num_samples",
            "fields.decay_length",
            "fields.min_information",
        ),
    ),
}


class Sizes(NamedTuple):
    """Entries of settings and names of those that are changed, by place, factors, and seeds."""

    places: Places = PLACES
    factors: tuple[float, ...] = (0.25, 4.0)
    runs: int = 2


FULL = Sizes()
# The loop of `tests/tuning/test_runs.py`, which the suite compiles anyway.
SMOKE = Sizes(
    {
        "path": (
            {
                "path": "track",
                "time_limit": 0.6,
                "controller": {"num_samples": 16, "horizon": 6, "temperature": 20.0},
            },
            ("controller.temperature",),
        )
    },
    (2.0,),
    1,
)


def measure(sizes: Sizes) -> Rows:
    """Return a row for each setting: times as long as with the default, for each factor."""
    rows = []
    for place, (entries, settings) in sizes.places.items():
        episodes = SettingsEpisodes({place: entries})
        default = _seconds(episodes, place, {}, sizes.runs)
        for setting in settings:
            row: dict[str, Any] = {"scenario": place, "setting": setting}
            for factor in sizes.factors:
                values = {
                    name: _scaled(episodes.start(name), factor)
                    for name in episodes.elements(setting)
                }
                row[f"x {factor:g}"] = _seconds(episodes, place, values, sizes.runs) / default
            rows.append({**row, "default_s": default})
    return rows


def _scaled(value: Any, factor: float) -> float | int:
    return max(1, round(value * factor)) if isinstance(value, int) else float(value) * factor


def _seconds(episodes: SettingsEpisodes, place: str, values: dict[str, Any], runs: int) -> float:
    found: list[float] = []

    def keep(_: Episode, result: Result) -> None:
        failed = result.error is not None
        found.append(float("inf") if failed else OBJECTIVE.value(result.metrics))

    episodes.run([Episode(0, values, place, seed) for seed in range(runs)], keep)
    return statistics.fmean(found)
