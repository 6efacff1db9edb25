import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from jaxplore.study.comparison.maps import maps_in
from jaxplore.study.comparison.rows import COLUMNS, Row, failed_row, result_of
from jaxplore.study.comparison.store import Asked, Store, open_store
from jaxplore.study.comparison.tasks import Batch, Task, make_tasks

Pretend = Callable[[Batch], list[Row]]


def test_what_is_put_there_is_done_and_what_failed_is_not(
    store: Store, asked: Asked, tasks: tuple[Task, ...], pretend: Pretend
) -> None:
    assert not any(store.is_done(task.id) for task in tasks)
    store.put(result_of(*pretend((tasks[0],))))
    store.put(result_of(failed_row(tasks[1], "no")))
    for each in (store, open_store(store.folder, asked), open_store(store.folder)):
        assert [each.is_done(task.id) for task in tasks] == [True, False, False, False]
        assert [row["error"] for row in each.rows(["error"])] == [None, "no"]
    store.put(result_of(*pretend((tasks[1],))))
    assert store.is_done(tasks[1].id)
    names = sorted(path.name for path in (store.folder / "runs").iterdir())
    assert names == sorted(f"{task.id}.parquet" for task in tasks[:2])


def test_results_are_sorted_whatever_order_they_come_in(
    store: Store, tasks: tuple[Task, ...], pretend: Pretend
) -> None:
    import pyarrow.parquet

    for task in tasks[::-1]:
        store.put(result_of(*pretend((task,))))
        before = store.write_results().read_bytes()
    table = pyarrow.parquet.read_table(store.results)
    assert table.column_names == list(COLUMNS)
    rows = table.to_pylist()
    assert rows == pretend(tasks) == store.rows()
    assert store.write_results().read_bytes() == before
    assert sorted(os.listdir(store.folder)) == ["benchmark.json", "results.parquet", "runs"]


def test_many_rows_are_written_a_few_at_a_time(
    store: Store, tasks: tuple[Task, ...], pretend: Pretend
) -> None:
    import pyarrow.parquet

    many = [dataclasses.replace(tasks[0], seed=seed) for seed in range(230)]
    for task in many:
        store.put(result_of(*pretend((task,))))
    store.write_results()
    file = pyarrow.parquet.ParquetFile(store.results)
    assert file.num_row_groups == 3
    assert file.read().column("seed").to_pylist() == list(range(230))


def test_an_empty_store_has_an_empty_table(store: Store) -> None:
    import pyarrow.parquet

    store.write_results()
    assert pyarrow.parquet.read_table(store.results).num_rows == 0


@pytest.mark.parametrize("content", [b"", b"PAR1", "other"])
def test_files_that_are_no_runs_are_not_there(
    store: Store, asked: Asked, tasks: tuple[Task, ...], pretend: Pretend, content: bytes | str
) -> None:
    import pyarrow
    import pyarrow.parquet

    store.put(result_of(*pretend((tasks[0],))))
    path = store.folder / "runs" / f"{tasks[0].id}.parquet"
    if isinstance(content, str):
        pyarrow.parquet.write_table(pyarrow.table({"id": [content]}), path)
    else:
        path.write_bytes(content)
    (path.parent / ".abc.tmp").write_bytes(b"cut off")
    again = open_store(store.folder, asked)
    assert not again.is_done(tasks[0].id)
    again.write_results()
    assert again.rows() == []


def test_a_former_benchmark_goes_on_with_more(
    store: Store, asked: Asked, tasks: tuple[Task, ...], pretend: Pretend
) -> None:
    store.put(result_of(*pretend((tasks[0],))))
    more = Asked(asked.maps[:1], ("portfolio", "explorer"), (7, 1), asked.settings)
    again = open_store(store.folder, more)
    assert again.is_done(tasks[0].id)
    document = json.loads((store.folder / "benchmark.json").read_text())
    assert document["explorers"] == ["explorer", "portfolio"]
    assert document["seeds"] == [0, 1, 7]
    assert list(document["maps"]) == ["east", "west"]
    assert document["maps"]["east"]["start"] == [1.0, 1.5, 0.5]
    assert document["format"] == 3
    assert document["settings"] == asked.settings


def test_settings_under_which_everything_failed_may_change(
    store: Store, asked: Asked, tasks: tuple[Task, ...], small: dict[str, Any]
) -> None:
    store.put(result_of(failed_row(tasks[0], "no")))
    other = dataclasses.replace(asked, settings={**small, "time_limit": 2.0}, seeds=(4,))
    assert open_store(store.folder, other).rows() == []
    document = json.loads((store.folder / "benchmark.json").read_text())
    assert document["settings"]["time_limit"] == 2.0
    assert document["seeds"] == [4]


def test_other_settings_are_refused(
    store: Store, asked: Asked, tasks: tuple[Task, ...], pretend: Pretend
) -> None:
    store.put(result_of(*pretend((tasks[0],))))
    before = (store.folder / "benchmark.json").read_text()
    for settings, reason in (
        ({**asked.settings, "time_limit": 2.0}, r"with time_limit 1\.5, asked is 2\.0; accepted"),
        ({**asked.settings, "hover_time": 2.0}, "with hover_time not given, asked is 2.0"),
        (
            {**asked.settings, "controller": {"num_samples": 16}},
            "with controller.horizon 8, asked is not given",
        ),
    ):
        with pytest.raises(ValueError, match=reason):
            open_store(store.folder, dataclasses.replace(asked, settings=settings))
    with pytest.raises(ValueError, match="with batch 1, asked is 4; accepted"):
        open_store(store.folder, dataclasses.replace(asked, batch=4))
    assert (store.folder / "benchmark.json").read_text() == before


def test_a_map_may_change_until_a_run_was_made_on_it(
    tmp_path: Path,
    store: Store,
    asked: Asked,
    tasks: tuple[Task, ...],
    pretend: Pretend,
    write_map: Callable[..., Path],
) -> None:
    east, west = tasks[0], tasks[2]
    store.put(result_of(*pretend((east,))))
    store.put(result_of(failed_row(west, "no")))
    write_map(tmp_path / "maps" / "west.yaml", 13)
    changed = dataclasses.replace(asked, maps=maps_in(tmp_path / "maps"))
    again = open_store(store.folder, changed)
    assert [row["map"] for row in again.rows()] == ["east"]
    write_map(tmp_path / "maps" / "east.yaml", 13)
    with pytest.raises(ValueError, match="has runs on east, whose content has changed since"):
        open_store(store.folder, dataclasses.replace(asked, maps=maps_in(tmp_path / "maps")))
    moved = (dataclasses.replace(asked.maps[0], start=(1.0, 1.0, 0.0)), changed.maps[1])
    with pytest.raises(ValueError, match="has runs on east, whose start has changed since"):
        open_store(store.folder, dataclasses.replace(asked, maps=moved))


@pytest.mark.parametrize(
    ("mark", "reason"),
    [
        ('{"format": 1}', "has format 1; accepted: format 3"),
        ('{"format": "2"}', "has format '2'; accepted: format 3"),
        ("{}", "its benchmark.json cannot be read: 'format'"),
        ("[1]", "its benchmark.json cannot be read"),
        ("{", "its benchmark.json cannot be read"),
        ('{"format": 3}', "its benchmark.json has no settings"),
        (None, "exists and holds no benchmark.json; accepted: a new folder"),
    ],
)
@pytest.mark.parametrize("overwrite", [False, True])
def test_other_folders_are_refused_and_left_alone(
    tmp_path: Path, asked: Asked, mark: str | None, reason: str, overwrite: bool
) -> None:
    folder = tmp_path / "taken"
    folder.mkdir()
    (folder / "mine.txt").write_text("mine")
    if mark is not None:
        (folder / "benchmark.json").write_text(mark)
    for what in (asked, None):
        with pytest.raises(ValueError, match=reason):
            open_store(folder, what, overwrite=overwrite)
    assert sorted(os.listdir(folder)) == sorted(
        ["mine.txt", *([] if mark is None else ["benchmark.json"])]
    )


def test_reading_needs_a_benchmark(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"holds no benchmark\.json; accepted: the folder of a"):
        open_store(tmp_path / "gone")
    assert not (tmp_path / "gone").exists()


def test_overwriting_begins_again(
    store: Store, asked: Asked, tasks: tuple[Task, ...], pretend: Pretend, small: dict[str, Any]
) -> None:
    store.put(result_of(*pretend((tasks[0],))))
    store.write_results()
    other = dataclasses.replace(asked, settings={**small, "time_limit": 3.0}, seeds=(4,))
    again = open_store(store.folder, other, overwrite=True)
    assert again.rows() == []
    assert sorted(os.listdir(store.folder)) == ["benchmark.json", "runs"]
    assert json.loads((store.folder / "benchmark.json").read_text())["seeds"] == [4]
    (changed, *_) = make_tasks(other.maps, other.explorers, other.seeds, other.settings)
    assert changed.id not in {task.id for task in tasks}


def test_a_folder_that_cannot_be_written_is_named(
    tmp_path: Path,
    store: Store,
    asked: Asked,
    tasks: tuple[Task, ...],
    pretend: Pretend,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match=r"file/in' cannot be written|exists and holds no"):
        open_store(tmp_path / "file" / "in", asked)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ValueError, match="No space left on device; accepted"):
        store.put(result_of(*pretend((tasks[0],))))
    assert list((store.folder / "runs").iterdir()) == []
    assert not store.is_done(tasks[0].id)
