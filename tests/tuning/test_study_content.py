"""Former studies that are damaged or foreign: one line, and nothing is changed."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import optuna
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
    return folder / "study.jsonl"


def lines_of(path: Path) -> list[Any]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def each(change: Callable[[dict[str, Any]], Any]):
    """Return a damage of every line that it changes, of which there is at least one."""

    def damage(path: Path) -> None:
        before = lines_of(path)
        after = [change(dict(line)) for line in lines_of(path)]
        after = [old if new is None else new for old, new in zip(before, after, strict=True)]
        assert after != before
        path.write_text("".join(json.dumps(line) + "\n" for line in after if line != {}))

    return damage


def put(name: str, value: Any, op: int | None = None):
    """Return a damage that sets an entry of the lines that have it, of one kind of operation."""
    return each(
        lambda line: (
            line | {name: value} if name in line and op in (None, line["op_code"]) else None
        )
    )


def attribute(begin: str, value: Any, kind: str = "user_attr"):
    """Return a damage that sets the attributes whose name begins with some letters."""

    def change(line: dict[str, Any]) -> Any:
        found = [name for name in line.get(kind, {}) if name.startswith(begin)]
        return line | {kind: dict.fromkeys(found, value)} if found else None

    return each(change)


def without(op: int):
    return each(lambda line: {} if line["op_code"] == op else None)


def text(more: str):
    return lambda path: path.write_text(path.read_text() + more)


CREATE_STUDY, CREATE_TRIAL, SET_PARAM, SET_STATE = 0, 4, 5, 6
"""Operations of Optuna's journal."""
DAMAGE = {
    "cut in front": lambda path: path.write_bytes(path.read_bytes()[100:]),
    "zeros at the end": lambda path: path.write_bytes(path.read_bytes() + bytes(100)),
    "a byte": lambda path: path.write_bytes(path.read_bytes().replace(b'"op_code": 4', b'"op_c4')),
    "no file": lambda path: (path.unlink(), path.mkdir()),
    "foreign": text("notes\n"),
    "foreign alone": lambda path: path.write_text("notes"),
    "a number": text("3\n"),
    "deep": text("[" * 100_000 + "\n"),
    "an empty line": text("\n"),
    "another operation": put("op_code", 77, CREATE_TRIAL),
    "another study": put("study_name", "other"),
    "study gone": without(CREATE_STUDY),
    "another direction": put("directions", [2]),
    "no direction": put("directions", []),
    "names": attribute("study:metric_names", [1, 2], "system_attr"),
    "two values": put("values", [1.0, 2.0], SET_STATE),
    "not finite": put("values", [float("nan")], SET_STATE),
    "no state": put("state", 9, SET_STATE),
    "no verdict": each(lambda line: {} if "verdict" in line.get("user_attr", {}) else None),
    "a list": attribute("episode ", []),
    "a text": attribute("episode ", {"metrics": {"cost": "x"}, "error": None, "is_cut": False}),
    "unseen": attribute("unseen ", 3),
    "definition": attribute("asked", [1]),
    "out of bounds": put("param_value_internal", 7.0),
    "another parameter": put("param_name", "b"),
}


def content(folder: Path) -> dict[str, bytes | None]:
    return {each.name: each.read_bytes() if each.is_file() else None
            for each in folder.iterdir() if each.name != ".lock"}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_study_is_one_line_and_stays_as_it_is(damage, good: Path, tmp_path: Path) -> None:
    shutil.copy(good, tmp_path / "study.jsonl")
    DAMAGE[damage](tmp_path / "study.jsonl")
    before = content(tmp_path)
    with (
        pytest.raises(
            ValueError, match=r"study\.jsonl' cannot be read: \w+; accepted: a study"
        ) as no,
        open_study(SEARCH, EPISODES, tmp_path),
    ):
        pass
    assert "\n" not in str(no.value)
    assert content(tmp_path) == before


def test_a_whole_study_goes_on_also_after_an_interruption(good: Path, tmp_path: Path) -> None:
    shutil.copy(good, tmp_path / "study.jsonl")
    with open_study(SEARCH, EPISODES, tmp_path) as study:
        former = study.trials()
        study.run(4)
        assert study.trials()[:2] == former
    whole = (tmp_path / "study.jsonl").read_bytes()
    with open_study(SEARCH, EPISODES, tmp_path) as study:
        values = [one.values for one in study.trials()]
    assert (tmp_path / "study.jsonl").read_bytes() == whole
    # A kill leaves the changes up to a moment, the last one perhaps in part.
    for end in (*range(0, len(whole), len(whole) // 25), len(whole) - 1):
        (tmp_path / "study.jsonl").write_bytes(whole[:end])
        with open_study(SEARCH, EPISODES, tmp_path) as study:
            study.run(4)
            assert [one.values for one in study.trials()] == values
            assert [one.state for one in study.trials()] == ["done"] * 4
        lines_of(tmp_path / "study.jsonl")


def test_dashboards_of_optuna_read_the_file(good: Path) -> None:
    backend = optuna.storages.journal.JournalFileBackend(str(good))
    study = optuna.load_study(
        study_name="jaxplore", storage=optuna.storages.JournalStorage(backend)
    )
    assert [trial.state.name for trial in study.trials] == ["COMPLETE"] * 2


def test_a_study_that_cannot_be_written_any_more_is_one_line(tmp_path: Path) -> None:
    def search() -> None:
        with open_study(SEARCH, EPISODES, tmp_path) as study:
            (tmp_path / "study.jsonl").write_bytes(b"overwritten by someone else")
            study.run(2)

    text = r"study\.jsonl' cannot be written: another program .*; accepted: a folder"
    with pytest.raises(ValueError, match=text):
        search()


@pytest.mark.parametrize("name", ["{}", "{0}", "%41", "a?b=c#d", "a b"])
def test_a_folder_may_have_any_name(name: str, tmp_path: Path) -> None:
    for budget in (1, 2):
        with open_study(SEARCH, EPISODES, tmp_path / name) as study:
            study.run(budget)
    assert [each.name for each in tmp_path.iterdir()] == [name]
    made = [line for line in lines_of(tmp_path / name / "study.jsonl") if line["op_code"] == 4]
    assert len(made) == 2


def test_a_study_on_a_full_disk_is_one_line_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    number = 0

    def full(file: int) -> None:
        nonlocal number
        number += 1
        if number == 20:
            os.truncate(file, os.fstat(file).st_size - 5)
            raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with (
            pytest.raises(ValueError, match=r"cannot be written: No space left on device; acc"),
            open_study(SEARCH, EPISODES, tmp_path) as study,
        ):
            study.run(4)
    with open_study(SEARCH, EPISODES, tmp_path) as study, open_study(SEARCH, EPISODES) as other:
        study.run(4)
        other.run(4)
        assert [one.values for one in study.trials()] == [one.values for one in other.trials()]
