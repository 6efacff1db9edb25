"""Check that a stored study holds what a search stores."""

import math
from collections.abc import Mapping
from typing import Any

from jaxplore.study.tuning.search import Search
from jaxplore.study.tuning.space import distribution
from jaxplore.study.tuning.trials import UNSEEN, VERDICT, make_trial, read_episodes

_STATES = ("done", "given up", "failed")


def check_content(study: Any, search: Search) -> None:
    """Check that a study of Optuna holds what a search stores; other content is an error."""
    expected = {each.name: distribution(each) for each in search.space.parameters}
    directions = [each.name for each in study.directions]
    _require(directions == ["MINIMIZE"] * len(search.objectives))
    # An interruption may come before the names are stored.
    _require(study.metric_names in (None, [str(each) for each in search.objectives]))
    for number, frozen in enumerate(study.get_trials(deepcopy=False)):
        trial = make_trial(frozen)
        _require(trial.number == number)
        fixed = frozen.system_attrs.get("fixed_params", {})
        _require(set(fixed) <= set(expected) and set(frozen.params) <= set(expected))
        _require(all(isinstance(each, int | float | str) for each in fixed.values()))
        for parameter in search.space.parameters:
            value = frozen.params.get(parameter.name)
            _require(value is None or parameter.clip(value) == value)
        _require(all(each == expected[name] for name, each in frozen.distributions.items()))
        if trial.state != "running":
            _require(set(frozen.params) == set(expected) and VERDICT in frozen.user_attrs)
        _require(trial.state != "done" or len(trial.values) == len(search.objectives))
        _require(all(_is_number(each) and math.isfinite(each) for each in trial.values))
        _require(all(map(_is_number, frozen.intermediate_values.values())))
        for stored in read_episodes(frozen.user_attrs).values():
            _require(_is_result(stored) and isinstance(stored["is_cut"], bool))
        if VERDICT in frozen.user_attrs:
            state, error = frozen.user_attrs[VERDICT]
            _require(state in _STATES and isinstance(error, str | None))
    for name, stored in study.user_attrs.items():
        _require(not name.startswith(UNSEEN) or _is_result(stored))


def _require(holds: bool) -> None:
    if not holds:
        raise ValueError("its content has another form")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_result(stored: Any) -> bool:
    metrics = stored["metrics"]
    return (
        isinstance(metrics, Mapping)
        and all(each is None or isinstance(each, int | float) for each in metrics.values())
        and isinstance(stored["error"], str | None)
    )
