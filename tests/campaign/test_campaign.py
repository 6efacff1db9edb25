"""A part of the campaign: cases of every category, and mutations of every format."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from . import command
from .cases import CATEGORIES, all_cases, some_cases
from .mutations import FORMATS, MUTATIONS
from .outcomes import Call, Judged, Outcome, judge, judge_stop
from .trials import Trials

pytestmark = pytest.mark.long

NUM_CASES, NUM_MUTATIONS, LEAST_MUTATIONS = 34, 10, 3


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trials]:
    return Trials(tmp_path_factory.mktemp("campaign") / "root")


@pytest.mark.parametrize("category", CATEGORIES)
def test_bad_input_is_accepted_or_refused_in_one_line(category: str, trials: Trials) -> None:
    found = [(case, trials.run(case)) for case in some_cases(category, NUM_CASES)]
    assert len(found) >= NUM_CASES
    bad = [f"{case.name}: {judged}" for case, judged in found if not judged.is_good]
    assert not bad, "\n".join(bad)


@pytest.mark.parametrize("name", FORMATS)
def test_the_files_that_are_mutated_are_accepted(name: str, trials: Trials) -> None:
    assert trials.mutate(name, (False, [], [])) == Judged(Outcome.ACCEPTED)


@pytest.mark.parametrize("name", FORMATS)
def test_mutated_files_are_accepted_or_refused_in_one_line(name: str, trials: Trials) -> None:
    number = max(LEAST_MUTATIONS, round(NUM_MUTATIONS * FORMATS[name].share))

    @hypothesis.settings(max_examples=number, database=None)
    @hypothesis.given(MUTATIONS)
    def check(mutation: Any) -> None:
        judged = trials.mutate(name, mutation)
        assert judged.is_good, judged

    check()


def test_the_cases_are_many_and_none_is_there_twice() -> None:
    cases = [case for category in CATEGORIES for case in all_cases(category)]
    names = {(case.category, case.name) for case in cases}
    assert len(names) == len(cases) > 10_000
    assert NUM_CASES * len(CATEGORIES) >= 400


LINE = "jaxplore: seed is -1; accepted: 0\n"


@pytest.mark.parametrize(
    ("call", "outcome"),
    [
        (Call(0, "done\n", ""), Outcome.ACCEPTED),
        (Call(2, "", LINE), Outcome.REFUSED),
        (Call(2, "", f"Start: 1 2 0\n{LINE}"), Outcome.REFUSED),
        (Call(2, "", LINE * 2), Outcome.MESSAGE),
        (Call(2, "", ""), Outcome.MESSAGE),
        (Call(2, "", "error\n"), Outcome.MESSAGE),
        (Call(2, "", f"jaxplore: {'x' * 500}\n"), Outcome.MESSAGE),
        (Call(2, "", "jaxplore: \x1b[31m\n"), Outcome.MESSAGE),
        (Call(0, "\x07", ""), Outcome.MESSAGE),
        (Call(1, "", LINE), Outcome.CODE),
        (Call(-9, "", ""), Outcome.CODE),
        (Call(2, "", LINE, 11.0), Outcome.SLOW),
        (Call(None, "", ""), Outcome.SLOW),
        (Call(2, "", LINE, 1.0, 3 * 2**30), Outcome.LARGE),
        (Call(2, "", LINE, has_changed=True), Outcome.CHANGED),
        (Call(0, "", "", has_changed=True), Outcome.ACCEPTED),
        (Call(1, "", "Traceback (most recent call last):\nKeyError: 3"), Outcome.TRACEBACK),
    ],
)
def test_outcomes_of_calls(call: Call, outcome: Outcome) -> None:
    assert judge(call).outcome == outcome


@pytest.mark.parametrize(
    ("code", "is_whole", "leftovers", "outcome"),
    [
        (130, True, (), Outcome.STOPPED),
        (143, True, (), Outcome.STOPPED),
        (-9, True, (), Outcome.STOPPED),
        (0, True, (), Outcome.ACCEPTED),
        (1, True, (), Outcome.CODE),
        (None, True, (), Outcome.SLOW),
        (130, False, (), Outcome.LOST),
        (130, True, (".x",), Outcome.LEFTOVER),
    ],
)
def test_outcomes_of_kills(
    code: int | None, is_whole: bool, leftovers: tuple[str, ...], outcome: Outcome
) -> None:
    found = judge_stop(Call(code, "", ""), is_whole=is_whole, leftovers=leftovers)
    assert found.outcome == outcome


def test_a_call_that_hangs_or_takes_all_memory_is_ended(
    trials: Trials, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def take(_: Any) -> None:
        taken = []
        while True:
            taken.append(bytes(b"x" * 2**24))

    monkeypatch.setattr(command, "main", take)
    monkeypatch.setattr(command, "MOST_BYTES", 2**28)
    ended = command.call([], tmp_path, tmp_path)
    assert ended.code is None
    assert ended.size > 2**28
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setattr(command, "main", lambda _: (tmp_path / "pipe").read_bytes())
    assert command.call([], tmp_path, tmp_path, 0.05).code is None
