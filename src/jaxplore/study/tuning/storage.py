"""Storage of a study in Optuna's SQLite database, written by one process at a time."""

import contextlib
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from jaxplore._optional import import_optional
from jaxplore._text import error_reason
from jaxplore.report.folder import lock_folder
from jaxplore.study.tuning.episodes import Episodes
from jaxplore.study.tuning.search import Search
from jaxplore.study.tuning.study import Study
from jaxplore.study.tuning.study_copy import (
    check_content,
    close_storage,
    open_former_study,
    storage_at,
)

FORMAT = 1
"""Version of the stored data."""
STUDY = "study.db"
"""File of Optuna's storage in the folder of a study."""
_NAME, _ASKED = "jaxplore", "asked"
"""Name of Optuna's study, and its attribute with the definition of the search."""


@contextlib.contextmanager
def open_study(search: Search, episodes: Episodes, folder: Path | None = None) -> Iterator[Study]:
    """Open the study of a search, a new one or a former one to continue.

    Args:
        search: definition of the search.
        episodes: where candidates are evaluated.
        folder: folder of `study.db`, which `optuna-dashboard` shows; missing parents are made. The
            study is in memory only when absent.

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
            former = _check_study(optuna, folder, search, asked)
            # A full disk may fail it already where the tables are made.
            stack.enter_context(_in_one_line(optuna, folder))
            storage = storage_at(optuna, folder / STUDY)
            stack.callback(close_storage, storage)
        # The first generation is evaluated completely, so that there is a median to compare with.
        pruner = (
            optuna.pruners.MedianPruner(n_startup_trials=search.population)
            if search.gives_up
            else optuna.pruners.NopPruner()
        )
        study = optuna.create_study(
            study_name=_NAME,
            storage=storage,
            directions=["minimize"] * len(search.objectives),
            load_if_exists=True,
            pruner=pruner,
        )
        if former is None:
            study.set_user_attr(_ASKED, asked)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # set_metric_names is experimental
                study.set_metric_names([str(each) for each in search.objectives])
        yield Study(search, episodes, study)


def _check_study(optuna: Any, folder: Path, search: Search, asked: dict[str, Any]) -> Any:
    """Return the definition that a folder's study was made with, or None without a study."""
    path, former, difference = folder / STUDY, None, None
    try:
        with open_former_study(optuna, path, _NAME) as study:
            former = None if study is None else study.user_attrs.get(_ASKED)
            if former is not None:
                difference = _difference(former, asked, str(folder))
                if difference is None:
                    check_content(study, search)
    except Exception as error:
        # Optuna and SQLAlchemy raise errors of many types for a file that is no study.
        raise ValueError(
            f"study {str(path)!r} cannot be read: {type(error).__name__}; accepted: a study of "
            "jaxplore tune, or a new folder"
        ) from None
    if difference is not None:
        raise ValueError(difference)
    return former


@contextlib.contextmanager
def _in_one_line(optuna: Any, folder: Path) -> Iterator[None]:
    """Convert errors of the storage during a search into one line."""
    try:
        yield
    except (
        optuna.exceptions.StorageInternalError,
        import_optional("sqlalchemy.exc", "tuning").SQLAlchemyError,
    ) as error:
        # Optuna's own text names no reason.
        causes = (error, error.__cause__, error.__context__)
        known = [each.orig for each in causes if getattr(each, "orig", None) is not None]
        reason = error_reason(known[0] if known else error)
        raise ValueError(
            f"study {str(folder / STUDY)!r} cannot be read or written: {reason}; accepted: "
            "a folder on a writable disk with space left"
        ) from error


def _difference(former: Any, asked: dict[str, Any], folder: str) -> str | None:
    """Return how two definitions of a study differ, or None if they do not."""
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
