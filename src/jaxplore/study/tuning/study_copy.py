"""Check a former study before Optuna opens it, which may write into any database."""

import functools
import math
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from jaxplore._files import open_regular
from jaxplore._optional import import_optional
from jaxplore.study.tuning.search import Search
from jaxplore.study.tuning.space import distribution
from jaxplore.study.tuning.trials import UNSEEN, VERDICT, make_trial, read_episodes

FILE_LIMIT = 2**31
"""Largest study that is read [bytes]."""
_SQLITE = b"SQLite format 3\0"
"""First bytes of a SQLite database."""
_VERSIONS = {"alembic_version", "version_info"}
"""Tables with the versions of Optuna's tables."""
_STATES = ("done", "given up", "failed")


@contextmanager
def open_former_study(optuna: Any, path: Path, name: str) -> Iterator[Any]:
    """Yield a copy of the study that a database stores, or None; the database is only read.

    Raises:
        Exception: a file that is no database, a damaged one, or one that stores something else. The
            errors of SQLite, SQLAlchemy and Optuna are of many types.
    """
    if not path.exists():
        yield None
        return
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        # SQLite keeps what an interrupted process has not finished in files beside the database.
        for end in ("", "-journal", "-wal"):
            _copy(path.with_name(path.name + end), copy.with_name(copy.name + end))
        with copy.open("rb") as file:
            if file.read(len(_SQLITE)) not in (_SQLITE, b""):
                raise ValueError("it is no SQLite database")
        held = _tables(copy)
        # A database without tables is a new one. One with others is not ours to write into.
        if held:
            empty = storage_at(optuna, Path(folder) / "empty.db")
            close_storage(empty)
            known = _tables(Path(folder) / "empty.db")
            # Tables of the same names with other columns are somebody else's.
            if any(name not in known or held[name][0] != known[name][0] for name in held):
                raise ValueError("it holds other tables")
        storage = storage_at(optuna, copy)
        try:
            names = optuna.get_all_study_names(storage)
            if set(names) - {name}:
                raise ValueError("it holds another study")
            # Without a study, only the versions of the tables may be there.
            if not names and any(held[each][1] for each in held.keys() - _VERSIONS):
                raise ValueError("it holds the rest of a study")
            study = optuna.load_study(study_name=name, storage=storage) if names else None
            # Optuna takes trials of equal numbers for one.
            if study is not None and len(study.get_trials(deepcopy=False)) != _num_trials(copy):
                raise ValueError("numbers of its trials are equal")
            yield study
        finally:
            close_storage(storage)


def storage_at(optuna: Any, path: Path) -> Any:
    """Open Optuna's storage in a file."""
    # One connection per transaction, so that no file stays open in between. In a URL, names with
    # braces, a question mark or a percent sign would mean something else than a path.
    connect = functools.partial(sqlite3.connect, path.absolute(), check_same_thread=False)
    pool = import_optional("sqlalchemy.pool", "tuning").NullPool
    options = {"poolclass": pool, "creator": connect}
    return optuna.storages.RDBStorage("sqlite:///study.db", engine_kwargs=options)


def close_storage(storage: Any) -> None:
    """Close Optuna's storage."""
    storage.remove_session()
    storage.engine.dispose()


def _copy(source: Path, target: Path) -> None:
    file = open_regular(source)
    if file is None:
        if source.exists():
            raise ValueError("it is not a file")
        return
    with file, target.open("xb") as copied:
        if file.seek(0, 2) > FILE_LIMIT:
            raise ValueError(f"it has more than {FILE_LIMIT} bytes")
        file.seek(0)
        shutil.copyfileobj(file, copied)


def _tables(path: Path) -> dict[str, tuple[set[str], bool]]:
    """Return the tables of a database that is whole and can be written: the columns of each, and
    whether it has rows."""
    with closing(sqlite3.connect(path)) as database:
        if database.execute("PRAGMA integrity_check(1)").fetchone() != ("ok",):
            raise ValueError("it is damaged")
        names = database.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
        # A damaged header may say that the database is for reading only.
        database.execute("CREATE TABLE written (it INTEGER)")
        database.execute("DROP TABLE written")
        return {
            name: (
                {row[1] for row in database.execute(f'PRAGMA table_info("{name}")')},
                database.execute(f'SELECT 1 FROM "{name}" LIMIT 1').fetchone() is not None,
            )
            for (name,) in names
        }


def _num_trials(path: Path) -> int:
    """Return the number of trials in a database."""
    with closing(sqlite3.connect(path)) as database:
        return int(database.execute("SELECT COUNT(*) FROM trials").fetchone()[0])


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
