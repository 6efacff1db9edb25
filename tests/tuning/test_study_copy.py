"""Former studies that are damaged or foreign: one line, and nothing is changed."""

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from jaxplore.study.tuning import (
    FunctionEpisodes,
    Objective,
    Parameter,
    Search,
    Space,
    open_study,
)

EPISODES = FunctionEpisodes(
    lambda values, seed: {"cost": (values["a"] - 0.3) ** 2 + seed, "a": values["a"]}, {"a": -0.9}
)
SEARCH = Search(
    Space((Parameter("a", -1.0, 1.0),)), (Objective.parse("cost"),), (0, 1), "random", population=2
)


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    with open_study(SEARCH, EPISODES, folder) as study:
        study.run(2)
        study.evaluate([0], [7])
    return folder / "study.db"


def sql(*statements: str):
    def change(path: Path) -> None:
        with closing(sqlite3.connect(path)) as database:
            for each in statements:
                assert database.execute(each).rowcount != 0
            database.commit()

    return change


def byte(index: int, value: int):
    def change(path: Path) -> None:
        data = bytearray(path.read_bytes())
        data[index] = value
        path.write_bytes(data)

    return change


TABLES = (
    *("trial_user_attributes", "trial_system_attributes", "trial_params", "trial_values"),
    *("trial_intermediate_values", "trials", "study_user_attributes", "study_system_attributes"),
    *("study_directions", "studies"),
)
"""Optuna's tables of one study."""
EPISODE = "UPDATE trial_user_attributes SET value_json = '{}' WHERE key LIKE 'episode %'"
DAMAGE = {
    "cut": lambda path: os.truncate(path, path.stat().st_size // 2),
    "for reading only": byte(18, 9),
    "a page": byte(4096 + 3, 77),
    "no file": lambda path: (path.unlink(), path.mkdir()),
    "foreign": sql("CREATE TABLE notes (text)"),
    "foreign alone": lambda path: (path.unlink(), sql("CREATE TABLE notes (text)")(path)),
    "foreign of the same name": lambda path: (
        path.unlink(),
        sql("CREATE TABLE trials (text)")(path),
    ),
    "another study": sql("UPDATE studies SET study_name = 'other'"),
    "study gone": sql("DELETE FROM studies"),
    "no direction": sql("DELETE FROM study_directions"),
    "names": sql("UPDATE study_system_attributes SET value_json = '[1, 2]'"),
    "two values": sql("UPDATE trial_values SET objective = 1"),
    "no state": sql("UPDATE trials SET state = 'DONE'"),
    "equal numbers": sql("UPDATE trials SET number = 0"),
    "no verdict": sql("DELETE FROM trial_user_attributes WHERE key = 'verdict'"),
    "a list": sql(EPISODE.format("[]")),
    "a text": sql(EPISODE.format('{"metrics": {"cost": "x"}, "error": null, "is_cut": false}')),
    "no JSON": sql(EPISODE.format("{")),
    "unseen": sql("UPDATE study_user_attributes SET value_json = '3' WHERE key LIKE 'unseen %'"),
    "definition": sql("UPDATE study_user_attributes SET value_json = '[1]' WHERE key = 'asked'"),
    "out of bounds": sql("UPDATE trial_params SET param_value = 7.0"),
}


def content(folder: Path) -> dict[str, bytes | None]:
    return {each.name: each.read_bytes() if each.is_file() else None
            for each in folder.iterdir() if each.name != ".lock"}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_study_is_one_line_and_stays_as_it_is(damage, good: Path, tmp_path: Path) -> None:
    shutil.copy(good, tmp_path / "study.db")
    DAMAGE[damage](tmp_path / "study.db")
    before = content(tmp_path)
    with (
        pytest.raises(ValueError, match=r"study\.db' cannot be read: \w+; accepted: a study") as no,
        open_study(SEARCH, EPISODES, tmp_path),
    ):
        pass
    assert "\n" not in str(no.value)
    assert content(tmp_path) == before


def test_a_whole_study_goes_on_also_after_an_interruption(good: Path, tmp_path: Path) -> None:
    shutil.copy(good, tmp_path / "study.db")
    with open_study(SEARCH, EPISODES, tmp_path) as study:
        former = study.trials()
        study.run(4)
        assert study.trials()[:2] == former
    # Interrupted while a candidate was made, after the tables were, and before.
    sql("UPDATE trials SET state = 'RUNNING' WHERE number = 3",
        "DELETE FROM trial_user_attributes WHERE trial_id = 4",
        "DELETE FROM trial_params WHERE trial_id = 4",
        "DELETE FROM trial_values WHERE trial_id = 4")(tmp_path / "study.db")  # fmt: skip
    with open_study(SEARCH, EPISODES, tmp_path) as study:
        study.run(4)
        assert [each.state for each in study.trials()] == ["done"] * 4
    with closing(sqlite3.connect(tmp_path / "study.db")) as database:
        for each in TABLES:
            database.execute(f"DELETE FROM {each}")
        database.commit()
    with open_study(SEARCH, EPISODES, tmp_path) as study:
        assert study.trials() == []
    (tmp_path / "study.db").write_bytes(b"")
    with open_study(SEARCH, EPISODES, tmp_path) as study:
        assert study.trials() == []


def test_a_study_that_cannot_be_written_any_more_is_one_line(tmp_path: Path) -> None:
    def search() -> None:
        with open_study(SEARCH, EPISODES, tmp_path) as study:
            (tmp_path / "study.db").write_bytes(b"overwritten by someone else")
            study.run(2)

    text = r"study\.db' cannot be read or written: .*; accepted: a folder"
    with pytest.raises(ValueError, match=text):
        search()


@pytest.mark.parametrize("name", ["{}", "{0}", "%41", "a?b=c#d", "a b"])
def test_a_folder_may_have_any_name(name: str, tmp_path: Path) -> None:
    for budget in (1, 2):
        with open_study(SEARCH, EPISODES, tmp_path / name) as study:
            study.run(budget)
    assert [each.name for each in tmp_path.iterdir()] == [name]
    with closing(sqlite3.connect(tmp_path / name / "study.db")) as database:
        assert database.execute("SELECT COUNT(*) FROM trials").fetchone() == (2,)
