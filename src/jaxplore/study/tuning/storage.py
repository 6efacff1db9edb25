"""Storage of a study in Optuna's SQLite database, written by one process at a time."""

import contextlib
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from jaxplore._optional import import_optional
from jaxplore.report.folder import locked_folder
from jaxplore.study.tuning.episodes import Episodes
from jaxplore.study.tuning.search import Search
from jaxplore.study.tuning.study import Study

FORMAT = 1
"""Version of the stored data."""
STUDY = "study.db"
"""File of Optuna's storage in the folder of a study."""
_NAME, _ASKED = "jaxplore", "asked"
"""Name of Optuna's study, and its attribute with the definition of the search."""
_SQLITE = b"SQLite format 3\0"
"""First bytes of a SQLite database."""


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
        storage = None
        if folder is not None:
            # A second search would mix its candidates into the study, so it is refused at once.
            stack.enter_context(locked_folder(folder, "study folder"))
            stack.enter_context(_errors_in_one_line(optuna, folder / STUDY))
            storage = _storage(optuna, folder)
            stack.callback(_close, storage)
        former = None
        if storage is not None and _NAME in optuna.get_all_study_names(storage):
            former = optuna.load_study(study_name=_NAME, storage=storage).user_attrs.get(_ASKED)
        if former is not None:
            _check_same(former, asked, str(folder))
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


@contextlib.contextmanager
def _errors_in_one_line(optuna: Any, path: Path) -> Iterator[None]:
    """Convert errors of the database, such as a full disk or a damaged file, into one line."""
    database = import_optional("sqlalchemy.exc", "tuning").SQLAlchemyError
    try:
        yield
    except (optuna.exceptions.StorageInternalError, database) as error:
        # Optuna's own text names no reason.
        causes = (error, error.__cause__, error.__context__)
        known = [each.orig for each in causes if getattr(each, "orig", None) is not None]
        reason = " ".join(str(known[0] if known else error).split())
        raise ValueError(
            f"study {str(path)!r} cannot be read or written: {reason}; accepted: a study of "
            "jaxplore tune, on a writable disk with space left"
        ) from error


def _close(storage: Any) -> None:
    storage.remove_session()
    storage.engine.dispose()


def _storage(optuna: Any, folder: Path) -> Any:
    path = folder / STUDY
    try:
        # An empty file is accepted, because SQLite takes it for a new database.
        if path.exists():
            with path.open("rb") as file:
                if file.read(len(_SQLITE)) not in (_SQLITE, b""):
                    raise ValueError("no SQLite")
        # One connection per transaction, so that no file stays open in between.
        options = {"poolclass": import_optional("sqlalchemy.pool", "tuning").NullPool}
        return optuna.storages.RDBStorage(f"sqlite:///{path.absolute()}", engine_kwargs=options)
    except Exception as error:
        # Optuna and SQLAlchemy raise errors of many types for a file that is no study.
        raise ValueError(
            f"study {str(path)!r} cannot be read: {type(error).__name__}; accepted: a study of "
            "jaxplore tune, or a new folder"
        ) from None


def _check_same(former: Any, asked: dict[str, Any], folder: str) -> None:
    # The scenarios are compared first: their names explain a mismatch better than a setting.
    ways = [list(each["episodes"].get("scenarios", ())) for each in (former, asked)]
    if ways[0] != ways[1]:
        was, is_ = (", ".join(names) or "none" for names in ways)
        raise ValueError(
            f"study folder {folder!r} was made for {was}, asked is {is_}; accepted: the same "
            "scenarios as before, or a new folder"
        )
    before, now = _flat(former), _flat(asked)
    for name in sorted({*before, *now}):
        if before.get(name) != now.get(name):
            was, is_ = (
                "not given" if name not in each else repr(each[name]) for each in (before, now)
            )
            raise ValueError(
                f"study folder {folder!r} was made with {name} {was}, asked is {is_}; accepted: "
                "the same command as before with any budget, or a new folder"
            )


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    if isinstance(value, Mapping) and value:
        found: dict[str, Any] = {}
        for name, inner in value.items():
            found |= _flat(inner, f"{prefix}.{name}" if prefix else str(name))
        return found
    # JSON has no tuples, so the stored definition comes back with lists.
    return {prefix: list(value) if isinstance(value, tuple) else value}
