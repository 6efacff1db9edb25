"""The folder of a benchmark: what was asked, a file for each run, and the table of all."""

import dataclasses
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.folder import in_one_line, write_whole
from jaxplore.study.comparison.maps import MapFile
from jaxplore.study.comparison.page import SHOWN, page
from jaxplore.study.comparison.rows import KEYS, Result, Row, schema
from jaxplore.study.comparison.tasks import FORMAT, Task, common_settings, make_tasks
from jaxplore.study.workers.packages import package

MARK = "benchmark.json"
"""The file by which a benchmark is recognised: version of the format, and what was asked."""
RESULTS = "results.parquet"
"""All rows, by map, explorer and seed."""
PAGE = "results.html"
"""The same to look at."""
RUNS = "runs"
"""Folder with a file for each run, named by its id."""

_ROWS_AT_ONCE = 100
_WHAT = "benchmark folder:"
_ACCEPTED = "accepted: the same command as before, or a new folder"


@dataclasses.dataclass(frozen=True)
class Asked:
    """What a benchmark is to find out.

    Args:
        maps: where.
        explorers: settings `architecture`.
        seeds: of the runs of each.
        settings: entries that all runs share.
        batch: runs computed side by side.
    """

    maps: tuple[MapFile, ...]
    explorers: tuple[str, ...]
    seeds: tuple[int, ...]
    settings: Mapping[str, Any]
    batch: int = 1

    def tasks(self) -> tuple[Task, ...]:
        """Return the runs that are asked for; see `make_tasks`."""
        return make_tasks(self.maps, self.explorers, self.seeds, self.settings, self.batch)

    def document(self) -> dict[str, Any]:
        """Return it as plain values that JSON can hold."""
        return {
            "format": FORMAT,
            "settings": common_settings(self.settings),
            "maps": {
                each.name: {
                    "path": each.path,
                    "content": each.content,
                    "start": None if each.start is None else list(each.start),
                }
                for each in self.maps
            },
            "explorers": list(self.explorers),
            "seeds": list(self.seeds),
            "batch": self.batch,
        }


class Store:
    """A folder of results. See `open_store`, which makes and checks it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._state = {
            row["id"]: (row["map"], row["error"])
            for _, row in _read(self._files(), ["id", "map", "error"])
        }

    @property
    def results(self) -> Path:
        """The table of all rows, where it has been written."""
        return self.folder / RESULTS

    def is_done(self, id_: str) -> bool:
        """Say whether there is a run of this id that did not fail."""
        _, error = self._state.get(id_, (None, ""))
        return error is None

    def put(self, result: Result) -> None:
        """Write a run's file: whole or not at all.

        Raises:
            ValueError: the folder cannot be written.
        """
        write_whole(self._file(result.id), lambda file: file.write(result.data), _WHAT)
        self._state[result.id] = (result.map, result.error)

    def rows(self, columns: Sequence[str] | None = None) -> list[Row]:
        """Return all rows that there are, by map, explorer and seed.

        Args:
            columns: names of some; all when absent.
        """
        wanted = None if columns is None else list(dict.fromkeys([*KEYS, *columns]))
        return [row for _, row in sorted(_read(self._files(), wanted), key=_place)]

    def write_results(self) -> Path:
        """Write the table of all rows, whole or not at all, and return where it is.

        Raises:
            ValueError: the folder cannot be written.
        """
        parquet, pyarrow = package("pyarrow.parquet", "benchmark"), package("pyarrow", "benchmark")
        files = [path for path, _ in sorted(_read(self._files(), list(KEYS)), key=_place)]

        def write(file: BinaryIO) -> None:
            # A few at a time: curves of thousands of runs need not fit into the memory.
            with parquet.ParquetWriter(file, schema()) as writer:
                for first in range(0, len(files), _ROWS_AT_ONCE):
                    some = files[first : first + _ROWS_AT_ONCE]
                    tables = [parquet.ParquetFile(path).read() for path in some]
                    writer.write_table(pyarrow.concat_tables(tables), _ROWS_AT_ONCE)

        write_whole(self.results, write, _WHAT)
        return self.results

    def write_page(self, maps: Mapping[str, OccupancyGrid]) -> Path:
        """Write the page of all results, whole or not at all, and return where it is.

        Args:
            maps: by name; see `page`.

        Raises:
            ValueError: the folder cannot be written.
        """
        text = page(self.rows(SHOWN), maps, f"Explorers on {self.folder.name}")
        target = self.folder / PAGE
        write_whole(target, lambda file: file.write(text.encode()), _WHAT)
        return target

    def forget(self, map_: str | None = None) -> None:
        """Remove the files of all runs, or of those on a map."""
        for id_ in [id_ for id_, (name, _) in self._state.items() if map_ in (None, name)]:
            self._file(id_).unlink(missing_ok=True)
            del self._state[id_]

    def has_run(self, map_: str | None = None) -> bool:
        """Say whether any run, or any on a map, did not fail."""
        return any(map_ in (None, name) and error is None for name, error in self._state.values())

    def _file(self, id_: str) -> Path:
        return self.folder / RUNS / f"{id_}.parquet"

    def _files(self) -> list[Path]:
        # What was cut off while it was written has a hidden name.
        return sorted(
            path for path in (self.folder / RUNS).glob("*.parquet") if path.name[0] != "."
        )


def open_store(
    folder: str | os.PathLike[str], asked: Asked | None = None, *, overwrite: bool = False
) -> Store:
    """Return the store in a folder; made if need be.

    A former benchmark goes on: with more maps, explorers or seeds, but with the same settings and
    batch, on maps with the same content and starts. What only failed may change: settings while
    there is no run at all, a map while there is none on it.

    Args:
        folder: missing parents are made.
        asked: what is to be found out; None to read what there is.
        overwrite: remove a former benchmark first.

    Raises:
        ValueError: a folder that cannot be written, is not a benchmark's, or another format's, or
            holds a benchmark of something else.
    """
    target = Path(os.path.realpath(folder))
    where = f"benchmark folder {os.fspath(folder)!r}"
    former = _former(target, where)
    if asked is None:
        if former is None:
            raise ValueError(f"{where} holds no {MARK}; accepted: the folder of a benchmark")
        return Store(target)
    if overwrite and former is not None:
        with in_one_line(_WHAT, target):
            shutil.rmtree(target / RUNS, ignore_errors=True)
            for name in (RESULTS, PAGE, MARK):
                (target / name).unlink(missing_ok=True)
        former = None
    document = asked.document()
    with in_one_line(_WHAT, target):
        (target / RUNS).mkdir(parents=True, exist_ok=True)
    store = Store(target)
    if former is not None:
        document = _together(former, document, store, where)
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    write_whole(target / MARK, lambda file: file.write(text.encode()), _WHAT)
    return store


def _former(target: Path, where: str) -> dict[str, Any] | None:
    """Return what was asked of a folder before; None of one that is empty or not there."""
    mark = target / MARK
    if not mark.is_file():
        if target.is_dir() and not any(target.iterdir()):
            return None
        if not os.path.lexists(target):
            return None
        raise ValueError(
            f"{where} exists and holds no {MARK}; accepted: a new folder, or a benchmark's"
        )
    try:
        former = json.loads(mark.read_text(encoding="utf-8"))
        version = former["format"]
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ValueError(
            f"{where}: its {MARK} cannot be read: {error}; accepted: a benchmark's"
        ) from None
    if version != FORMAT:
        raise ValueError(f"{where} has format {version!r}; accepted: format {FORMAT}")
    for name, kind in {"settings": dict, "maps": dict, "explorers": list, "seeds": list}.items():
        if not isinstance(former.get(name), kind):
            raise ValueError(f"{where}: its {MARK} has no {name}; accepted: a benchmark's")
    return dict(former)


def _together(
    former: dict[str, Any], asked: dict[str, Any], store: Store, where: str
) -> dict[str, Any]:
    """Return what is asked beside what was asked before."""
    if not store.has_run():
        store.forget()
        return asked
    before, now = (
        {**_flat(each["settings"]), "batch": each.get("batch", 1)} for each in (former, asked)
    )
    for name in sorted({*before, *now}):
        if before.get(name) != now.get(name):
            raise ValueError(
                f"{where} has runs with {name} {_text(before.get(name))}, asked is "
                f"{_text(now.get(name))}; {_ACCEPTED}"
            )
    for name, entry in asked["maps"].items():
        was = former["maps"].get(name, entry)
        changed = [part for part in ("content", "start") if was.get(part) != entry[part]]
        if changed and store.has_run(name):
            raise ValueError(
                f"{where} has runs on {name}, whose {changed[0]} has changed since; {_ACCEPTED}"
            )
        if changed:
            store.forget(name)
    return {
        "format": FORMAT,
        "settings": asked["settings"],
        "maps": dict(sorted({**former["maps"], **asked["maps"]}.items())),
        "explorers": list(dict.fromkeys([*former["explorers"], *asked["explorers"]])),
        "seeds": sorted({*former["seeds"], *asked["seeds"]}),
        "batch": asked["batch"],
    }


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in settings.items():
        inner = isinstance(value, dict)
        flat |= _flat(value, f"{prefix}{name}.") if inner else {f"{prefix}{name}": value}
    return flat


def _text(value: object) -> str:
    return "not given" if value is None else repr(value)


def _read(files: Sequence[Path], columns: list[str] | None) -> Iterator[tuple[Path, Row]]:
    """Yield the rows of files. One that is no row, after a power cut say, is not there."""
    parquet, pyarrow = package("pyarrow.parquet", "benchmark"), package("pyarrow", "benchmark")
    expected = schema()
    for path in files:
        try:
            with parquet.ParquetFile(path) as file:
                is_row = file.schema_arrow.equals(expected) and file.metadata.num_rows == 1
                rows = file.read(columns=columns).to_pylist() if is_row else []
        except (OSError, pyarrow.ArrowException):
            continue
        yield from ((path, row) for row in rows)


def _place(item: tuple[Path, Row]) -> tuple[Any, ...]:
    return tuple(item[1][name] for name in KEYS)
