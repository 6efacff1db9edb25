"""Candidates of a study, and what came of them."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from jaxplore.study.tuning.objective import Numbers
from jaxplore.study.tuning.space import Candidate, Value

EPISODE = "episode "
"""Begins the names under which a trial keeps its episodes."""
VERDICT = "verdict"
"""Name under which it keeps what became of it, and an error."""


class Trial(NamedTuple):
    """A candidate and what came of it.

    Args:
        number: from 0, the settings that there were before.
        candidate: its values.
        values: of the objectives; empty if it failed.
        state: "done", "given up", "failed", or "running" where it was cut off.
        episodes: metrics by scenario and seed.
        error: why it failed.
    """

    number: int
    candidate: Candidate
    values: tuple[float, ...]
    state: str
    episodes: dict[tuple[str, int], Numbers]
    error: str | None = None


def trial_of(frozen: Any) -> Trial:
    """Return a candidate from a trial as Optuna keeps it."""
    names = {"COMPLETE": "done", "PRUNED": "given up", "FAIL": "failed"}
    state = names.get(frozen.state.name, "running")
    values: tuple[float, ...] = ()
    if state == "done":
        values = tuple(frozen.values)
    elif state == "given up":
        values = (frozen.user_attrs["value"],)
    episodes = {
        where: told["metrics"]
        for where, told in episodes_of(frozen.user_attrs).items()
        if told["error"] is None
    }
    candidate: dict[str, Value] = dict(frozen.params)
    return Trial(frozen.number, candidate, values, state, episodes, frozen.user_attrs.get("error"))


def episodes_of(attributes: Mapping[str, Any]) -> dict[tuple[str, int], Any]:
    """Return what a trial's attributes keep of its episodes, by scenario and seed."""
    found = {}
    for name, told in attributes.items():
        if name.startswith(EPISODE):
            scenario, _, seed = name.removeprefix(EPISODE).rpartition(" ")
            found[scenario, int(seed)] = told
    return found
