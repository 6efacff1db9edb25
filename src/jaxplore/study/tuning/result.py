"""Result of a search."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

from jaxplore.study.tuning.objective import Numbers
from jaxplore.study.tuning.significance import Change
from jaxplore.study.tuning.space import Candidate
from jaxplore.study.tuning.trials import Trial

type Unseen = Mapping[tuple[str, int], Numbers]
"""Metrics of episodes by scenario and seed; empty for a failed episode."""


@dataclasses.dataclass(frozen=True)
class TuningResult:
    """Result of a search.

    Args:
        chosen: best candidate on seeds that the search did not use.
        current: values before the search.
        trials: all candidates, by number.
        front: candidates of the Pareto front, which no other candidate dominates.
        is_complete: whether the search was completed; if not, Ctrl-C ended it.
        before: metrics of the current values on unseen seeds, by scenario and seed.
        after: metrics of the chosen candidate on the same unseen seeds.
        changes: changes of the objectives and the metrics from `before` to `after`, with 95 %
            intervals.
        verdict: whether the chosen candidate is better than the current values, in a sentence.
        files: files that were written.
    """

    chosen: Trial
    current: Candidate
    trials: tuple[Trial, ...]
    front: tuple[Trial, ...]
    is_complete: bool
    before: Unseen
    after: Unseen
    changes: tuple[Change, ...]
    verdict: str
    files: tuple[Path, ...] = ()

    def rows(self) -> list[tuple[str, ...]]:
        """Return one table: the header, the parameters, then the changes on unseen seeds."""
        header, *changes = self.change_rows()
        parameters = [(*row, "") for row in self.settings_rows()[1:]]
        return [("", *header[1:]), *parameters, *changes]

    def settings_rows(self) -> list[tuple[str, ...]]:
        """Return a table of the parameters: the header, then a row for each."""
        return [
            ("", "before", "after"),
            *(
                (name, short_text(self.current[name]), short_text(value))
                for name, value in self.chosen.candidate.items()
            ),
        ]

    def change_rows(self) -> list[tuple[str, ...]]:
        """Return a table of the changes on unseen seeds: the header, then a row for each.

        A time that was not reached in every episode has no mean, and shows in how many it was
        reached. An objective has a value in each episode. If some of them contain a time that was
        not reached, their number stands beside it.
        """
        objectives = len(self.chosen.values)
        rows: list[tuple[str, ...]] = [("mean", "before", "after", "difference [95 % interval]")]
        for number, each in enumerate(self.changes):
            means = [short_text(each.before), short_text(each.after)]
            late = [each.late_before, each.late_after]
            difference = f"{each.difference:+.4g} [{each.low:+.4g}, {each.high:+.4g}]"
            # The objectives come first, see `changes`.
            if number < objectives:
                means = [
                    f"{mean} ({count} of {each.episodes} not reached)" if count else mean
                    for mean, count in zip(means, late, strict=True)
                ]
            elif any(late):
                means = [
                    f"reached in {each.episodes - count} of {each.episodes}" if count else mean
                    for mean, count in zip(means, late, strict=True)
                ]
                difference = ""
            rows.append((each.name, *means, difference))
        return rows


def short_text(value: object) -> str:
    """Format a value; numbers have four digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
