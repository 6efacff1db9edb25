import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxplore._locks import OWN
from jaxplore.report.folder import lock_folder
from jaxplore.study.comparison.compare_maps import compare_maps
from jaxplore.study.comparison.episodes import EpisodeBatch, MapEpisode, make_episodes
from jaxplore.study.comparison.maps import maps_in
from jaxplore.study.comparison.rows import COLUMNS, Row, make_failed_row, store_row
from jaxplore.study.comparison.store import Plan, Store, open_store

Pretend = Callable[[EpisodeBatch], list[Row]]


def test_what_is_put_there_is_done_and_what_failed_is_not(
    store: Store, plan: Plan, episodes: tuple[MapEpisode, ...], pretend: Pretend
) -> None:
    assert not any(store.is_done(episode.id) for episode in episodes)
    store.put(store_row(*pretend((episodes[0],))))
    store.put(store_row(make_failed_row(episodes[1], "no")))
    for each in (store, open_store(store.folder, plan), open_store(store.folder)):
        assert [each.is_done(episode.id) for episode in episodes] == [True, False, False, False]
        assert [row["error"] for row in each.rows(["error"])] == [None, "no"]
    store.put(store_row(*pretend((episodes[1],))))
    assert store.is_done(episodes[1].id)
    names = sorted(path.name for path in (store.folder / "runs").iterdir())
    assert names == sorted(f"{episode.id}.parquet" for episode in episodes[:2])


def test_results_are_sorted_whatever_order_they_come_in(
    store: Store, episodes: tuple[MapEpisode, ...], pretend: Pretend
) -> None:
    import pyarrow.parquet

    for episode in episodes[::-1]:
        store.put(store_row(*pretend((episode,))))
        before = store.write_results().read_bytes()
    table = pyarrow.parquet.read_table(store.results)
    assert table.column_names == list(COLUMNS)
    rows = table.to_pylist()
    assert rows == pretend(episodes) == store.rows()
    assert store.write_results().read_bytes() == before
    assert sorted(os.listdir(store.folder)) == ["comparison.json", "results.parquet", "runs"]


def test_many_rows_are_written_a_few_at_a_time(
    store: Store, episodes: tuple[MapEpisode, ...], pretend: Pretend
) -> None:
    import pyarrow.parquet

    many = [dataclasses.replace(episodes[0], seed=seed) for seed in range(230)]
    for episode in many:
        store.put(store_row(*pretend((episode,))))
    store.write_results()
    file = pyarrow.parquet.ParquetFile(store.results)
    assert file.num_row_groups == 3
    assert file.read().column("seed").to_pylist() == list(range(230))


def test_an_empty_store_has_an_empty_table(store: Store) -> None:
    import pyarrow.parquet

    store.write_results()
    assert pyarrow.parquet.read_table(store.results).num_rows == 0


def test_damaged_rows_are_not_there(
    store: Store, plan: Plan, episodes: tuple[MapEpisode, ...], pretend: Pretend
) -> None:
    """A byte changed anywhere leaves a row as it was, or it is made again."""
    (row,) = pretend((episodes[0],))
    data, path = store_row(row).data, store.folder / "runs" / f"{episodes[0].id}.parquet"
    rng, num_lost = np.random.default_rng(0), 0
    for place in rng.integers(0, len(data), 60):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x40]) + data[place + 1 :])
        rows = open_store(store.folder, plan).rows()
        assert rows in ([], [row])
        num_lost += not rows
    assert num_lost > 10
    path.write_bytes(data)
    # The row of another run, one whose curves do not fit, and what waits for ever if it is read.
    for other in ({"id": "other"}, {"curve_time": [1.0, 2.0], "curve_coverage": [1.0]}):
        path.write_bytes(store_row({**row, **other}).data)
        assert open_store(store.folder, plan).rows() == []
    path.unlink()
    os.mkfifo(path)
    assert open_store(store.folder, plan).rows() == []


@pytest.mark.parametrize("content", [b"", b"PAR1", "other"])
def test_files_that_are_no_runs_are_not_there(
    store: Store,
    plan: Plan,
    episodes: tuple[MapEpisode, ...],
    pretend: Pretend,
    content: bytes | str,
) -> None:
    import pyarrow
    import pyarrow.parquet

    store.put(store_row(*pretend((episodes[0],))))
    path = store.folder / "runs" / f"{episodes[0].id}.parquet"
    if isinstance(content, str):
        pyarrow.parquet.write_table(pyarrow.table({"id": [content]}), path)
    else:
        path.write_bytes(content)
    (path.parent / ".abc.tmp").write_bytes(b"cut off")
    again = open_store(store.folder, plan)
    assert not again.is_done(episodes[0].id)
    again.write_results()
    assert again.rows() == []


def test_two_comparisons_in_one_folder_are_refused(
    store: Store, plan: Plan, episodes: tuple[MapEpisode, ...], pretend: Pretend
) -> None:
    store.put(store_row(*pretend((episodes[0],))))
    before = sorted(store.folder.rglob("*"))
    with lock_folder(store.folder, "comparison folder"):
        for overwrite in (False, True):
            with pytest.raises(ValueError, match="is in use by another process, number"):
                compare_maps(plan, store.folder, overwrite=overwrite)
    assert sorted(store.folder.rglob("*")) == before
    # A refusal makes no folder, and a lock that is left over is no content.
    with pytest.raises(ValueError, match="seeds"):
        compare_maps(dataclasses.replace(plan, seeds=(0, 0)), store.folder.parent / "new")
    assert not (store.folder.parent / "new").exists()
    (store.folder.parent / "new").mkdir()
    (store.folder.parent / "new" / OWN).touch()
    assert open_store(store.folder.parent / "new", plan).rows() == []


def test_a_former_comparison_goes_on_with_more(
    store: Store, plan: Plan, episodes: tuple[MapEpisode, ...], pretend: Pretend
) -> None:
    store.put(store_row(*pretend((episodes[0],))))
    more = Plan(plan.maps[:1], ("portfolio", "explorer"), (7, 1), plan.settings)
    again = open_store(store.folder, more)
    assert again.is_done(episodes[0].id)
    document = json.loads((store.folder / "comparison.json").read_text())
    assert document["explorers"] == ["explorer", "portfolio"]
    assert document["seeds"] == [0, 1, 7]
    assert list(document["maps"]) == ["east", "west"]
    assert document["maps"]["east"]["start"] == [1.0, 1.5, 0.5]
    assert document["format"] == 3
    assert document["settings"] == plan.settings


def test_settings_under_which_everything_failed_may_change(
    store: Store, plan: Plan, episodes: tuple[MapEpisode, ...], small: dict[str, Any]
) -> None:
    store.put(store_row(make_failed_row(episodes[0], "no")))
    other = dataclasses.replace(plan, settings={**small, "time_limit": 2.0}, seeds=(4,))
    assert open_store(store.folder, other).rows() == []
    document = json.loads((store.folder / "comparison.json").read_text())
    assert document["settings"]["time_limit"] == 2.0
    assert document["seeds"] == [4]


def test_other_settings_are_refused(
    store: Store, plan: Plan, episodes: tuple[MapEpisode, ...], pretend: Pretend
) -> None:
    store.put(store_row(*pretend((episodes[0],))))
    before = (store.folder / "comparison.json").read_text()
    for settings, reason in (
        ({**plan.settings, "time_limit": 2.0}, r"with time_limit 1\.5, asked is 2\.0; accepted"),
        ({**plan.settings, "hover_time": 2.0}, "with hover_time not given, asked is 2.0"),
        (
            {**plan.settings, "controller": {"num_samples": 16}},
            "with controller.horizon 8, asked is not given",
        ),
    ):
        with pytest.raises(ValueError, match=reason):
            open_store(store.folder, dataclasses.replace(plan, settings=settings))
    with pytest.raises(ValueError, match="with batch 1, asked is 4; accepted"):
        open_store(store.folder, dataclasses.replace(plan, batch=4))
    assert (store.folder / "comparison.json").read_text() == before


def test_a_map_may_change_until_a_run_was_made_on_it(
    tmp_path: Path,
    store: Store,
    plan: Plan,
    episodes: tuple[MapEpisode, ...],
    pretend: Pretend,
    write_map: Callable[..., Path],
) -> None:
    east, west = episodes[0], episodes[2]
    store.put(store_row(*pretend((east,))))
    store.put(store_row(make_failed_row(west, "no")))
    write_map(tmp_path / "maps" / "west.yaml", 13)
    changed = dataclasses.replace(plan, maps=maps_in(tmp_path / "maps"))
    again = open_store(store.folder, changed)
    assert [row["map"] for row in again.rows()] == ["east"]
    write_map(tmp_path / "maps" / "east.yaml", 13)
    with pytest.raises(ValueError, match="has runs on east, whose content has changed since"):
        open_store(store.folder, dataclasses.replace(plan, maps=maps_in(tmp_path / "maps")))
    moved = (dataclasses.replace(plan.maps[0], start=(1.0, 1.0, 0.0)), changed.maps[1])
    with pytest.raises(ValueError, match="has runs on east, whose start has changed since"):
        open_store(store.folder, dataclasses.replace(plan, maps=moved))


def mark_with(**parts: Any) -> str:
    plan = {"format": 3, "settings": {}, "maps": {}, "explorers": ["a"], "seeds": [0], **parts}
    return json.dumps(plan)


@pytest.mark.parametrize(
    ("mark", "reason"),
    [
        ('{"format": 1}', "has format 1; accepted: format 3"),
        ('{"format": "2"}', "has format '2'; accepted: format 3"),
        ("{}", "its comparison.json cannot be read: 'format'"),
        ("[1]", "its comparison.json cannot be read"),
        ("{", "its comparison.json cannot be read"),
        ('{"format": 3}', "its comparison.json has no settings"),
        (mark_with(seeds=["0"]), "its comparison.json has no seeds as"),
        (mark_with(explorers=[1]), "its comparison.json has no explorers as"),
        (mark_with(maps={"a": 1}), "its comparison.json has no maps as"),
        (mark_with(maps={"a": {"content": 3}}), "its comparison.json has no maps as"),
        (mark_with(variants={"a": 1}), "its comparison.json has no variants as"),
        ("[" * 5000, "its comparison.json cannot be read"),
        (None, "exists and holds no comparison.json; accepted: a new folder"),
    ],
)
@pytest.mark.parametrize("overwrite", [False, True])
def test_other_folders_are_refused_and_left_alone(
    tmp_path: Path, plan: Plan, mark: str | None, reason: str, overwrite: bool
) -> None:
    folder = tmp_path / "taken"
    folder.mkdir()
    (folder / "mine.txt").write_text("mine")
    if mark is not None:
        (folder / "comparison.json").write_text(mark)
    for what in (plan, None):
        with pytest.raises(ValueError, match=reason):
            open_store(folder, what, overwrite=overwrite)
    assert sorted(os.listdir(folder)) == sorted(
        ["mine.txt", *([] if mark is None else ["comparison.json"])]
    )


@pytest.mark.parametrize("name", ["results.parquet", "results.html"])
def test_a_folder_in_place_of_a_file_is_refused_before_the_runs(
    store: Store, plan: Plan, name: str
) -> None:
    (store.folder / name).mkdir()
    with pytest.raises(ValueError, match=f"its {name} is a folder; accepted: a file"):
        open_store(store.folder, plan)


def test_reading_needs_a_comparison(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"holds no comparison\.json; accepted: the folder of a"):
        open_store(tmp_path / "gone")
    assert not (tmp_path / "gone").exists()


def test_overwriting_begins_again(
    store: Store,
    plan: Plan,
    episodes: tuple[MapEpisode, ...],
    pretend: Pretend,
    small: dict[str, Any],
) -> None:
    store.put(store_row(*pretend((episodes[0],))))
    store.write_results()
    other = dataclasses.replace(plan, settings={**small, "time_limit": 3.0}, seeds=(4,))
    again = open_store(store.folder, other, overwrite=True)
    assert again.rows() == []
    assert sorted(os.listdir(store.folder)) == ["comparison.json", "runs"]
    assert json.loads((store.folder / "comparison.json").read_text())["seeds"] == [4]
    (changed, *_) = make_episodes(other.maps, other.variants, other.seeds, other.settings)
    assert changed.id not in {episode.id for episode in episodes}


def test_a_folder_that_cannot_be_written_is_named(
    tmp_path: Path,
    store: Store,
    plan: Plan,
    episodes: tuple[MapEpisode, ...],
    pretend: Pretend,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match=r"file/in' cannot be written|exists and holds no"):
        open_store(tmp_path / "file" / "in", plan)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ValueError, match="No space left on device; accepted"):
        store.put(store_row(*pretend((episodes[0],))))
    assert list((store.folder / "runs").iterdir()) == []
    assert not store.is_done(episodes[0].id)


def test_a_folder_of_a_former_version_continues(
    store: Store, plan: Plan, episodes: tuple[MapEpisode, ...], pretend: Pretend
) -> None:
    store.put(store_row(*pretend((episodes[0],))))
    (store.folder / "comparison.json").rename(store.folder / "benchmark.json")
    again = open_store(store.folder, plan)
    assert again.is_done(episodes[0].id)
    assert sorted(os.listdir(store.folder)) == ["comparison.json", "runs"]


def test_a_variant_keeps_its_settings(
    store: Store, plan: Plan, episodes: tuple[MapEpisode, ...], pretend: Pretend
) -> None:
    store.put(store_row(*pretend((episodes[0],))))
    slow = {"robot": {"max_speed": 0.5}}
    open_store(store.folder, dataclasses.replace(plan, variants={"slow": slow}))
    document = json.loads((store.folder / "comparison.json").read_text())
    assert document["explorers"] == ["explorer", "slow"]
    assert document["variants"] == {"slow": {**slow, "architecture": "explorer"}}
    for variants, reason in (
        ({"slow": {"robot": {"max_speed": 0.6}}}, "variant slow.robot.max_speed 0.5, asked is 0.6"),
        ({"explorer": slow}, "variant explorer.robot.max_speed not given, asked is 0.5"),
    ):
        with pytest.raises(ValueError, match=reason):
            open_store(store.folder, dataclasses.replace(plan, variants=variants))
