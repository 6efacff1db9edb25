"""What becomes of episodes, with workers that are none, and of runs here."""

import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from jaxplore.study import experiments as running
from jaxplore.study import runner
from jaxplore.study.comparison.compare_maps import EpisodeDone, RunCounts, run_episodes
from jaxplore.study.comparison.episodes import EpisodeBatch, MapEpisode, make_episodes
from jaxplore.study.comparison.row_task import RowTask, make_rows
from jaxplore.study.comparison.rows import Row
from jaxplore.study.comparison.store import Plan, Store, open_store
from jaxplore.study.runner import Runner

Pretend = Callable[[EpisodeBatch], list[Row]]
Die = Callable[[int, MapEpisode | None], bool]
Spread = Callable[..., tuple[list[tuple[int, RowTask]], RunCounts]]
Timeless = Callable[[Store], list[Row]]


@pytest.fixture
def many(plan: Plan) -> tuple[MapEpisode, ...]:
    return make_episodes(plan.maps, ("explorer", "portfolio"), range(4), plan.settings)


@pytest.fixture
def spread(scripted: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> Spread:
    def run(
        episodes: tuple[MapEpisode, ...], store: Store, make: Pretend, die: Die
    ) -> tuple[list[tuple[int, RowTask]], RunCounts]:
        """Run episodes on two workers and return who got what; they are closed in any case."""
        pool = scripted(2, lambda worker, runs: die(worker, runs and runs.episodes[0]))
        monkeypatch.setattr(runner, "ProcessPool", lambda _: pool)
        try:
            counts = run_episodes(episodes, store, Runner(2), make=make)
        finally:
            assert pool.closed
        return pool.given, counts

    return run


def test_a_task_of_which_three_workers_die_has_failed(
    many: tuple[MapEpisode, ...], store: Store, pretend: Pretend, spread: Spread
) -> None:
    given, counts = spread(many, store, pretend, lambda _, episode: episode == many[6])
    assert counts == (16, 1, 0, False)
    died = [worker for worker, runs in given if runs.episodes == (many[6],)]
    assert len(died) == len(set(died)) == 3
    failed = {row["id"]: row["error"] for row in store.rows(["id", "error"]) if row["error"]}
    assert failed == {many[6].id: "3 workers died of it: killed by SIGKILL"}


def test_workers_that_never_start_are_not_started_for_ever(
    many: tuple[MapEpisode, ...], store: Store, pretend: Pretend, spread: Spread
) -> None:
    with pytest.raises(ChildProcessError, match="workers do not start: never ready"):
        spread(many, store, pretend, lambda _, episode: episode is None)
    assert store.results.exists()


def test_it_goes_on_where_it_was_and_tries_again_what_failed(
    many: tuple[MapEpisode, ...], store: Store, plan: Plan, pretend: Pretend
) -> None:
    calls: list[MapEpisode] = []
    shown: list[EpisodeDone] = []

    def fragile(batch: EpisodeBatch) -> list[Row]:
        calls.extend(batch)
        if batch == (many[2],) and len(calls) < 5:
            raise ValueError("not now")
        return pretend(batch)

    assert run_episodes(many[:4], store, on_done=shown.append, make=fragile) == (4, 1, 0, False)
    assert calls == list(many[:4])
    assert [(each.num_done, each.num_left, each.error) for each in shown] == [
        (1, 4, None),
        (2, 4, None),
        (3, 4, "not now"),
        (4, 4, None),
    ]
    again = open_store(store.folder, plan)
    assert run_episodes(many[:6], again, make=fragile) == (3, 0, 3, False)
    assert calls[4:] == [many[2], *many[4:6]]
    assert run_episodes(many[:6], again, make=fragile) == (0, 0, 6, False)
    assert store.rows() == pretend(many[:6])


def test_ctrl_c_keeps_what_is_done_and_the_rest_gives_the_same_table(
    episodes: tuple[MapEpisode, ...], store: Store, plan: Plan, timeless: Timeless, tmp_path: Path
) -> None:
    def third(batch: EpisodeBatch) -> tuple[Row, ...]:
        if batch == (episodes[2],):
            raise KeyboardInterrupt
        return make_rows(batch)

    assert run_episodes(episodes, store, make=third) == (2, 0, 0, True)
    found = timeless(store)
    assert [row["id"] for row in found] == [episode.id for episode in episodes[:2]]
    again = open_store(store.folder, plan)
    # Also where a key is pressed between two runs. What is started in the background ignores it.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        first = run_episodes(episodes, again, on_done=lambda _: signal.raise_signal(signal.SIGINT))
    finally:
        signal.signal(signal.SIGINT, before)
    assert first == (1, 0, 2, True)
    assert run_episodes(episodes, open_store(store.folder, plan)) == (1, 0, 3, False)
    whole = open_store(tmp_path / "whole", plan)
    assert run_episodes(episodes, whole) == (4, 0, 0, False)
    assert timeless(again) == timeless(whole)
    assert timeless(whole)[:2] == found
    assert len({tuple(row["positions_x"]) for row in timeless(whole)}) == 4


def test_a_run_that_is_stopped_is_no_run(
    episodes: tuple[MapEpisode, ...], store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, calls = running.record_run, []

    def pressed(*arguments: object, **options: object) -> object:
        calls.append(arguments)
        press = len(calls) == 2
        return original(
            *arguments,  # type: ignore[arg-type]
            **options,  # type: ignore[arg-type]
            on_progress=lambda _: signal.raise_signal(signal.SIGINT) if press else None,
        )

    monkeypatch.setattr(running, "record_run", pressed)
    assert run_episodes(episodes, store) == (1, 0, 0, True)
    assert [row["id"] for row in store.rows(["id"])] == [episodes[0].id]


def test_maps_that_cannot_be_read_fail_alone(
    episodes: tuple[MapEpisode, ...], store: Store, plan: Plan
) -> None:
    Path(episodes[0].path).with_suffix(".pgm").unlink()
    assert run_episodes(episodes, store) == (4, 2, 0, False)
    errors = [row["error"] for row in store.rows(["error"])]
    assert errors[2:] == [None, None]
    assert all("image is 'east.pgm', which is not there" in each for each in errors[:2])


def test_what_is_left_of_a_batch_is_done_together(
    plan: Plan, store: Store, pretend: Pretend, spread: Spread
) -> None:
    episodes = make_episodes(plan.maps[:1], plan.variants, range(1, 8), plan.settings, 3)
    run_episodes(episodes[3:4], store, make=pretend)
    fatal = [episodes[2]]

    def die(_: int, episode: MapEpisode | None) -> bool:
        is_fatal = episode in fatal
        if is_fatal:
            fatal.clear()
        return is_fatal

    shown: list[EpisodeDone] = []
    given, counts = spread(episodes, store, pretend, die)
    assert counts == (6, 0, 1, False)
    seeds = [[episode.seed for episode in runs.episodes] for _, runs in given]
    assert sorted(seeds) == [[1, 2], [3, 5], [3, 5], [6, 7]]
    assert store.rows() == pretend(episodes)
    again = make_episodes(plan.maps[1:], plan.variants, range(2), plan.settings, 2)
    run_episodes(again, store, on_done=shown.append, make=pretend)
    assert [(each.episode, each.num_done, each.num_left) for each in shown] == [
        (again[0], 1, 2),
        (again[1], 2, 2),
    ]


@pytest.mark.parametrize("number", [0, -1])
def test_a_number_of_workers_is_named(
    episodes: tuple[MapEpisode, ...], store: Store, number: int
) -> None:
    with pytest.raises(ValueError, match=f"workers is {number}; accepted: a whole number >= 1"):
        run_episodes(episodes, store, Runner(number))


def test_packages_that_are_missing_are_named(
    episodes: tuple[MapEpisode, ...], store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ValueError, match=r"ray is not installed.*install '\.\[distributed\]'"):
        run_episodes(episodes, store, Runner(None, on_ray=True))
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ValueError, match=r"pyarrow is not installed.*'\.\[comparison\]'"):
        run_episodes(episodes, store)
