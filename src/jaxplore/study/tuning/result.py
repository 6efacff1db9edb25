"""Result of a search."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

from jaxplore.study.tuning.objective import Numbers
from jaxplore.study.tuning.significance import Change
from jaxplore.study.tuning.space import Candidate
from jaxplore.study.tuning.trials import Trial

type Unseen = Mapping[tuple[str, int], Numbers]
"""Metrics of episodes by scenario and seed; empty for an episode that failed."""


@dataclasses.dataclass(frozen=True)
class TuningResult:
    """Result of a search.

    Args:
        chosen: the best candidate by seeds that the search did not use.
        current: the values before the search.
        trials: all candidates, by number.
        front: those that no other one beats in every objective.
        is_complete: whether everything was done; if not, Ctrl-C ended it.
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
        """Return one table: its header, the parameters, then the changes on unseen seeds."""
        header, *changes = self.change_rows()
        parameters = [(*row, "") for row in self.settings_rows()[1:]]
        return [("", *header[1:]), *parameters, *changes]

    def settings_rows(self) -> list[tuple[str, ...]]:
        """Return a table of the parameters: its header, then a row for each."""
        return [
            ("", "before", "after"),
            *(
                (name, short_text(self.current[name]), short_text(value))
                for name, value in self.chosen.candidate.items()
            ),
        ]

    def change_rows(self) -> list[tuple[str, ...]]:
        """Return a table of the changes on unseen seeds: its header, then a row for each."""
        return [
            ("mean", "before", "after", "difference [95 % interval]"),
            *(
                (
                    each.name,
                    short_text(each.before),
                    short_text(each.after),
                    f"{each.difference:+.4g} [{each.low:+.4g}, {each.high:+.4g}]",
                )
                for each in self.changes
            ),
        ]


def short_text(value: object) -> str:
    """Return a value as text, numbers with four digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
