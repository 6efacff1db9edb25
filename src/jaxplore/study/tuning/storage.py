"""Storage of a study: a file with a line of JSON for each change, written by one process at a time.

Optuna holds the study in memory and replays the lines when a search continues. What a line says is
never changed, so a file that was cut off is an earlier state of the study.
"""

import contextlib
import json
import math
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxplore._files import open_regular
from jaxplore._optional import import_optional
from jaxplore._text import error_reason
from jaxplore.report.folder import lock_folder
from jaxplore.study.tuning.episodes import Episodes
from jaxplore.study.tuning.search import Search
from jaxplore.study.tuning.space import distribution
from jaxplore.study.tuning.study import Study
from jaxplore.study.tuning.trials import UNSEEN, VERDICT, make_trial, read_episodes

FORMAT = 2
"""Version of the stored data."""
STUDY = "study.jsonl"
"""File of the changes in the folder of a study; Optuna calls it a journal."""
FILE_LIMIT = 2**31
"""Largest study that is read [bytes]."""
_BEGIN = b'{"op_code": '
"""First bytes of a line."""
_NAME, _ASKED = "jaxplore", "asked"
"""Name of Optuna's study, and its attribute with the definition of the search."""

_STATES = ("done", "given up", "failed")


@contextlib.contextmanager
def open_study(search: Search, episodes: Episodes, folder: Path | None = None) -> Iterator[Study]:
    """Open the study of a search, a new one or a former one to continue.

    Args:
        search: definition of the search.
        episodes: where candidates are evaluated.
        folder: folder of `study.jsonl`, which `optuna-dashboard` shows; missing parents are made.
            The study is in memory only when absent.

    Raises:
        ValueError: Optuna is not installed; a folder that cannot be written, also later in the
            body, that another process uses, or that holds another study.
    """
    optuna = import_optional("optuna", "tuning")
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    # As plain values, to compare with the stored definition.
    asked = {"format": FORMAT, "search": search.describe(), "episodes": episodes.describe()}
    with contextlib.ExitStack() as stack:
        storage = former = None
        if folder is not None:
            # A second search would mix its candidates into the study, so it is refused at once.
            stack.enter_context(lock_folder(folder, "study folder"))
            storage, former = _read_former(optuna, folder, search, asked)
        # The first generation is evaluated completely, so that there is a median to compare with.
        pruner = (
            optuna.pruners.MedianPruner(n_startup_trials=search.population)
            if search.gives_up
            else optuna.pruners.NopPruner()
        )
        if storage is not None and storage.get_all_studies():
            study = optuna.load_study(study_name=_NAME, storage=storage, pruner=pruner)
        else:
            directions = ["minimize"] * len(search.objectives)
            study = optuna.create_study(
                study_name=_NAME, storage=storage, directions=directions, pruner=pruner
            )
        if former is None:
            study.set_user_attr(_ASKED, asked)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # set_metric_names is experimental
                study.set_metric_names([str(each) for each in search.objectives])
        yield Study(search, episodes, study)


class _Journal:
    """The changes of a study in a file, for Optuna's `JournalStorage`."""

    def __init__(self, path: Path) -> None:
        self._path, self._logs, self._size, self._rest = path, list[Any](), 0, 0
        file = open_regular(path)
        if file is None:
            if os.path.lexists(path):
                raise ValueError("it is not a file")
            return
        with file:
            data = file.read(FILE_LIMIT + 1)
        if len(data) > FILE_LIMIT:
            raise ValueError(f"it has more than {FILE_LIMIT} bytes")
        *lines, rest = data.split(b"\n")
        # A process that was killed may have left the beginning of a line.
        if rest[: len(_BEGIN)] != _BEGIN[: len(rest)]:
            raise ValueError("it holds something else")
        self._logs = [json.loads(line) for line in lines]
        self._size, self._rest = len(data) - len(rest), len(rest)

    def read_logs(self, first: int) -> Iterator[dict[str, Any]]:
        yield from self._logs[first:]

    def append_logs(self, logs: Sequence[dict[str, Any]]) -> None:
        lines = [json.dumps(each) for each in logs]
        data = "".join(f"{line}\n" for line in lines).encode()
        try:
            with self._path.open("ab") as file:
                if file.tell() != self._size + self._rest:
                    raise OSError("another program has changed it")
                file.truncate(self._size)
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise ValueError(
                f"study {str(self._path)!r} cannot be written: {error_reason(error)}; accepted: "
                "a folder on a writable disk with space left"
            ) from error
        self._logs += map(json.loads, lines)
        self._size, self._rest = self._size + len(data), 0


def _read_former(
    optuna: Any, folder: Path, search: Search, asked: dict[str, Any]
) -> tuple[Any, Any]:
    """Return the storage in a folder, and the definition that its study was made with, or None."""
    path, former, difference = folder / STUDY, None, None
    try:
        journal = _Journal(path)
        storage = optuna.storages.JournalStorage(journal)
        names = optuna.get_all_study_names(storage)
        # Optuna passes over changes of what it does not know.
        if names != [_NAME] and (names or any(journal.read_logs(0))):
            raise ValueError("it holds another study")
        if names:
            study = optuna.load_study(study_name=_NAME, storage=storage)
            former = study.user_attrs.get(_ASKED)
            difference = None if former is None else _difference(former, asked, str(folder))
            if difference is None:
                _check_content(study, search)
    except Exception as error:
        # Optuna raises errors of many types for lines that are not its own.
        raise ValueError(
            f"study {str(path)!r} cannot be read: {type(error).__name__}; accepted: a study of "
            "jaxplore tune, or a new folder"
        ) from None
    if difference is not None:
        raise ValueError(difference)
    return storage, former


def _difference(former: Any, asked: dict[str, Any], folder: str) -> str | None:
    # The scenarios are compared first: their names explain a mismatch better than a setting.
    ways = [list(each["episodes"].get("scenarios", ())) for each in (former, asked)]
    if ways[0] != ways[1]:
        was, is_ = (", ".join(names) or "none" for names in ways)
        return (
            f"study folder {folder!r} was made for {was}, asked is {is_}; accepted: the same "
            "scenarios as before, or a new folder"
        )
    before, now = _flat(former), _flat(asked)
    for name in sorted({*before, *now}):
        if before.get(name) != now.get(name):
            was, is_ = (
                "not given" if name not in each else repr(each[name]) for each in (before, now)
            )
            return (
                f"study folder {folder!r} was made with {name} {was}, asked is {is_}; accepted: "
                "the same command as before with any budget, or a new folder"
            )
    return None


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    if isinstance(value, Mapping) and value:
        found: dict[str, Any] = {}
        for name, inner in value.items():
            found |= _flat(inner, f"{prefix}.{name}" if prefix else str(name))
        return found
    # JSON has no tuples, so the stored definition comes back with lists.
    return {prefix: list(value) if isinstance(value, tuple) else value}


def _check_content(study: Any, search: Search) -> None:
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
