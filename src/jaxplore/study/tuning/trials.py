"""Candidates of a study and their results."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from jaxplore.study.tuning.objective import Numbers
from jaxplore.study.tuning.space import Candidate, Value

EPISODE = "episode "
"""Prefix of the attributes in which a trial stores its episodes."""
UNSEEN = "unseen "
"""Prefix of the attributes in which a study stores episodes on unseen seeds."""
VERDICT = "verdict"
"""Attribute in which a trial stores its state and an error."""


class Trial(NamedTuple):
    """A candidate and its results.

    Args:
        number: number of the candidate; 0 is the current settings.
        candidate: value of each parameter.
        values: values of the objectives; empty if it failed.
        state: "done", "given up", "failed", or "running" if it was interrupted.
        episodes: metrics by scenario and seed.
        error: reason of a failure; None if it did not fail.
    """

    number: int
    candidate: Candidate
    values: tuple[float, ...]
    state: str
    episodes: dict[tuple[str, int], Numbers]
    error: str | None = None


def make_trial(frozen: Any) -> Trial:
    """Convert a trial of Optuna."""
    names = {"COMPLETE": "done", "PRUNED": "given up", "FAIL": "failed"}
    state = names.get(frozen.state.name, "running")
    values: tuple[float, ...] = ()
    if state == "done":
        values = tuple(frozen.values)
    elif state == "given up":
        values = (frozen.user_attrs["value"],)
    episodes = {
        where: stored["metrics"]
        for where, stored in read_episodes(frozen.user_attrs).items()
        if stored["error"] is None
    }
    candidate: dict[str, Value] = dict(frozen.params)
    return Trial(frozen.number, candidate, values, state, episodes, frozen.user_attrs.get("error"))


def read_episodes(attributes: Mapping[str, Any]) -> dict[tuple[str, int], Any]:
    """Read the episodes from the attributes of a trial, by scenario and seed."""
    found = {}
    for name, stored in attributes.items():
        if name.startswith(EPISODE):
            scenario, _, seed = name.removeprefix(EPISODE).rpartition(" ")
            found[scenario, int(seed)] = stored
    return found
