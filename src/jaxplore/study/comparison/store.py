"""The folder of a comparison on maps: its plan, one file per run, and the table of results."""

import dataclasses
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from jaxplore._files import MALFORMED, open_regular, parse_json, read_bytes
from jaxplore._locks import OWN
from jaxplore._optional import import_optional
from jaxplore._text import short_repr
from jaxplore.maps.datum import Datum
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.drawing.figure import write_figure
from jaxplore.report.folder import in_one_line, write_whole
from jaxplore.study.comparison.episodes import (
    FORMAT,
    Entries,
    MapEpisode,
    common_settings,
    make_episodes,
    variant_entries,
)
from jaxplore.study.comparison.maps import MapFile, kind_of_map
from jaxplore.study.comparison.page import NO_DATUMS, SHOWN, page, page_figures
from jaxplore.study.comparison.rows import KEYS, Row, StoredRow, is_row, schema
from jaxplore.tasks.kind import Kind
from jaxplore.tasks.registry import default_kind, files_of

MARK = "comparison.json"
"""File by which a comparison is recognised: version of the format, and the plan."""
FORMER_MARK = "benchmark.json"
"""Former name of that file. The next run in such a folder renames it."""
RESULTS = "results.parquet"
"""All rows, by map, variant and seed."""
PAGE = "results.html"
"""The page."""
FIGURES = "figures"
"""Folder with the figures of the page as PDF or SVG."""
RUNS = "runs"
"""Folder with a file for each run, named by its id."""

MARK_LIMIT = 2**24
"""Largest such file that is read [bytes]."""
_ROWS_AT_ONCE = 100
_WHAT = "comparison folder:"
_ACCEPTED = "accepted: the same command as before, or a new folder"


@dataclasses.dataclass(frozen=True)
class Plan:
    """The runs of a comparison: each variant on each map with each seed.

    Args:
        maps: maps to run on.
        variants: architectures, or settings entries that differ, by name.
        seeds: seeds of the runs of each variant.
        settings: settings entries that all runs share.
        batch: runs computed side by side.
        asked: settings of which each must be read by some run; all when absent.
    """

    maps: tuple[MapFile, ...]
    variants: tuple[str, ...] | Mapping[str, Entries]
    seeds: Sequence[int]
    settings: Entries = dataclasses.field(default_factory=dict)
    batch: int = 1
    asked: Entries | None = None

    def episodes(self) -> tuple[MapEpisode, ...]:
        """Return all runs; see `make_episodes`."""
        return make_episodes(
            self.maps, self.variants, self.seeds, self.settings, self.batch, asked=self.asked
        )

    @property
    def kind(self) -> Kind:
        """Kind of task of the runs, that of the first map."""
        return kind_of_map(self.maps[0].selector)[0] if self.maps else default_kind()

    def with_protocol(self) -> "Plan":
        """Return the plan with its settings merged over the defaults of a comparison."""
        settings = files_of(self.kind.selector).with_protocol(self.settings)
        asked = self.settings if self.asked is None else self.asked
        return dataclasses.replace(self, settings=settings, asked=asked)

    def document(self) -> dict[str, Any]:
        """Return the plan as plain values for JSON."""
        own = {
            name: each for name, each in variant_entries(self.variants, self.kind).items() if each
        }
        return {
            "format": FORMAT,
            "settings": common_settings(self.settings, self.kind),
            "maps": {
                each.name: {
                    "path": each.path,
                    "content": each.content,
                    "start": None if each.start is None else list(each.start),
                }
                for each in self.maps
            },
            "explorers": list(self.variants),
            **({"variants": own} if own else {}),
            "seeds": list(self.seeds),
            "batch": self.batch,
            **({} if self.kind is default_kind() else {"kind": self.kind.name}),
        }


class Store:
    """A folder of results; `open_store` makes and checks it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._damaged: frozenset[Path] = frozenset()
        files = self._files()
        found = {path: row for path, row in _read(files, None) if is_row(row, path.stem)}
        self._state = {row["id"]: (row["map"], row["error"]) for row in found.values()}
        self._damaged = frozenset(files) - frozenset(found)

    @property
    def results(self) -> Path:
        """Path of the table of all rows."""
        return self.folder / RESULTS

    def is_done(self, id_: str) -> bool:
        """Check whether a run with this id has succeeded."""
        # An unknown run has an error without text, so it is not done.
        _, error = self._state.get(id_, (None, ""))
        return error is None

    def put(self, row: StoredRow) -> None:
        """Write the file of a run, completely or not at all."""
        write_whole(self._file(row.id), lambda file: file.write(row.data), _WHAT)
        self._damaged -= {self._file(row.id)}
        self._state[row.id] = (row.map, row.error)

    def rows(self, columns: Sequence[str] | None = None) -> list[Row]:
        """Return all rows, by map, variant and seed, with the `columns` or with all of them."""
        wanted = None if columns is None else list(dict.fromkeys([*KEYS, *columns]))
        return [row for _, row in sorted(_read(self._files(), wanted), key=_place)]

    def write_results(self) -> Path:
        """Write the table of all rows, completely or not at all, and return its path."""
        parquet, pyarrow = (
            import_optional("pyarrow.parquet", "comparison"),
            import_optional("pyarrow", "comparison"),
        )
        files = [path for path, _ in sorted(_read(self._files(), list(KEYS)), key=_place)]

        def write(file: BinaryIO) -> None:
            # In parts: thousands of runs may not fit into memory.
            with parquet.ParquetWriter(file, schema()) as writer:
                for first in range(0, len(files), _ROWS_AT_ONCE):
                    some = files[first : first + _ROWS_AT_ONCE]
                    tables = [parquet.ParquetFile(path).read() for path in some]
                    writer.write_table(pyarrow.concat_tables(tables), _ROWS_AT_ONCE)

        write_whole(self.results, write, _WHAT)
        return self.results

    def write_page(
        self, maps: Mapping[str, OccupancyGrid], datums: Mapping[str, Datum] = NO_DATUMS
    ) -> Path:
        """Write the `page` of all results, completely or not at all, and return its path."""
        text = page(self.rows(SHOWN), maps, f"Comparison {self.folder.name}", datums)
        target = self.folder / PAGE
        write_whole(target, lambda file: file.write(text.encode()), _WHAT)
        return target

    def write_figures(
        self,
        maps: Mapping[str, OccupancyGrid],
        kinds: Sequence[str],
        datums: Mapping[str, Datum] = NO_DATUMS,
    ) -> None:
        """Write the figures of the page, in `figure_formats`, into the folder `figures`."""
        folder = self.folder / FIGURES
        with in_one_line(_WHAT, folder):
            folder.mkdir(exist_ok=True)
            for name, figure in page_figures(self.rows(SHOWN), maps, datums):
                # A map in a folder has a slash in its name.
                write_figure(figure, folder, re.sub(r"[^\w.+-]", "_", name), kinds)

    def forget(self, map_: str | None = None) -> None:
        """Remove the files of all runs, or of those on a map."""
        for id_ in [id_ for id_, (name, _) in self._state.items() if map_ in (None, name)]:
            self._file(id_).unlink(missing_ok=True)
            del self._state[id_]

    def has_run(self, map_: str | None = None) -> bool:
        """Check whether any run, or any run on a map, has succeeded."""
        return any(map_ in (None, name) and error is None for name, error in self._state.values())

    def _file(self, id_: str) -> Path:
        return self.folder / RUNS / f"{id_}.parquet"

    def _files(self) -> list[Path]:
        """Return the files of rows, those of other stores of the folder included."""
        # Incomplete files have hidden names and are skipped.
        files = (path for path in (self.folder / RUNS).glob("*.parquet") if path.name[0] != ".")
        return sorted(set(files) - self._damaged)


def open_store(
    folder: str | os.PathLike[str], plan: Plan | None = None, *, overwrite: bool = False
) -> Store:
    """Open or create the store in a folder, and its missing parents.

    A former comparison is continued, or removed first with `overwrite`. Without a plan its results
    are only read. Maps, variants and seeds may be added; the settings, the batch size and the
    content and starts of the maps must stay. Settings may change as long as no run has succeeded,
    and a map as long as no run on it has.

    Raises:
        ValueError: a folder that cannot be written, or that does not hold a comparison of the same
            format and settings.
    """
    target = Path(os.path.realpath(folder))
    where = f"comparison folder {os.fspath(folder)!r}"
    former = _read_former(target, where)
    if plan is None:
        if former is None:
            raise ValueError(f"{where} holds no {MARK}; accepted: the folder of a comparison")
        return Store(target)
    if overwrite and former is not None:
        with in_one_line(_WHAT, target):
            for name in (RUNS, FIGURES):
                shutil.rmtree(target / name, ignore_errors=True)
            for name in (RESULTS, PAGE, MARK, FORMER_MARK):
                (target / name).unlink(missing_ok=True)
        former = None
    document = plan.document()
    # The folder is made here, because `put` writes into an existing one.
    with in_one_line(_WHAT, target):
        (target / RUNS).mkdir(parents=True, exist_ok=True)
    # A file that cannot be replaced is said before the runs, not after them.
    for name in (RESULTS, PAGE, MARK):
        if (target / name).is_dir():
            raise ValueError(f"{where}: its {name} is a folder; accepted: a file")
    store = Store(target)
    if former is not None:
        document = _together(former, document, store, where)
    # The plan is stored before any run, so that an interrupted comparison is recognised.
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    write_whole(target / MARK, lambda file: file.write(text.encode()), _WHAT)
    # The former mark goes last, so that the folder has a mark at any time.
    (target / FORMER_MARK).unlink(missing_ok=True)
    return store


def _read_former(target: Path, where: str) -> dict[str, Any] | None:
    """Read the former plan of a folder; None if the folder is empty or missing."""
    mark = target / MARK
    if not mark.is_file() and (target / FORMER_MARK).is_file():
        mark = target / FORMER_MARK
    if not mark.is_file():
        if target.is_dir() and all(each.name == OWN for each in target.iterdir()):
            return None
        if not os.path.lexists(target):
            return None
        raise ValueError(
            f"{where} exists and holds no {MARK}; accepted: a new folder, or that of a comparison"
        )
    try:
        former = parse_json(read_bytes(mark, "a comparison's", MARK_LIMIT), MARK_LIMIT)
        version = former["format"]
    except (ValueError, LookupError, TypeError) as error:
        raise ValueError(
            f"{where}: its {mark.name} cannot be read: {error}; accepted: that of a comparison"
        ) from None
    if version != FORMAT:
        raise ValueError(f"{where} has format {short_repr(version)}; accepted: format {FORMAT}")
    for name, is_part in _PARTS.items():
        if not is_part(former.get(name)):
            raise ValueError(
                f"{where}: its {mark.name} has no {name} as comparisons have them; accepted: that "
                "of a comparison"
            )
    return dict(former)


def _is_map(entry: object) -> bool:
    if not isinstance(entry, dict):
        return False
    return isinstance(entry.get("content"), str) and isinstance(entry.get("start"), list | None)


_PARTS: dict[str, Callable[[Any], bool]] = {
    "settings": lambda part: isinstance(part, dict),
    "maps": lambda part: isinstance(part, dict) and all(map(_is_map, part.values())),
    "explorers": lambda part: isinstance(part, list) and all(isinstance(e, str) for e in part),
    "seeds": lambda part: isinstance(part, list) and all(type(each) is int for each in part),
    "variants": lambda part: (
        part is None
        or (isinstance(part, dict) and all(isinstance(each, dict) for each in part.values()))
    ),
}
"""Parts of the stored plan, and what they must be."""


def _together(
    former: dict[str, Any], asked: dict[str, Any], store: Store, where: str
) -> dict[str, Any]:
    """Merge a former and a new plan, and check that they agree."""
    # Without a successful run nothing binds the new plan to the former one.
    if not store.has_run():
        store.forget()
        return asked
    both = set(former["explorers"]) & set(asked["explorers"])
    before, now = (
        {
            **_flat(each["settings"]),
            **_flat({name: each.get("variants", {}).get(name, {}) for name in both}, "variant "),
            "batch": each.get("batch", 1),
            "kind": each.get("kind", default_kind().name),
        }
        for each in (former, asked)
    )
    for name in sorted({*before, *now}):
        if before.get(name) != now.get(name):
            raise ValueError(
                f"{where} has runs with {name} {_text(before.get(name))}, asked is "
                f"{_text(now.get(name))}; {_ACCEPTED}"
            )
    for name, entry in asked["maps"].items():
        # A map that is new to the folder has nothing to differ from.
        was = former["maps"].get(name, entry)
        changed = [part for part in ("content", "start") if was.get(part) != entry[part]]
        if changed and store.has_run(name):
            raise ValueError(
                f"{where} has runs on {name}, whose {changed[0]} has changed since; {_ACCEPTED}"
            )
        if changed:
            store.forget(name)
    variants = {**former.get("variants", {}), **asked.get("variants", {})}
    return {
        "format": FORMAT,
        "settings": asked["settings"],
        "maps": dict(sorted({**former["maps"], **asked["maps"]}.items())),
        "explorers": list(dict.fromkeys([*former["explorers"], *asked["explorers"]])),
        **({"variants": variants} if variants else {}),
        "seeds": sorted({*former["seeds"], *asked["seeds"]}),
        "batch": asked["batch"],
        **{name: asked[name] for name in ("kind",) if name in asked},
    }


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in settings.items():
        inner = isinstance(value, dict)
        flat |= _flat(value, f"{prefix}{name}.") if inner else {f"{prefix}{name}": value}
    return flat


def _text(value: object) -> str:
    return "not given" if value is None else short_repr(value)


def _read(files: Sequence[Path], columns: list[str] | None) -> Iterator[tuple[Path, Row]]:
    """Yield the rows of files; a damaged file, as after a power cut, is skipped."""
    parquet = import_optional("pyarrow.parquet", "comparison")
    arrow = import_optional("pyarrow", "comparison")
    expected = schema()
    for path in files:
        try:
            opened = open_regular(path)
            if opened is None:
                continue
            with opened, parquet.ParquetFile(opened, page_checksum_verification=True) as file:
                # A row of another version has other columns, and is run again.
                is_row = file.schema_arrow.equals(expected) and file.metadata.num_rows == 1
                rows = file.read(columns=columns).to_pylist() if is_row else []
        except (*MALFORMED, OSError, arrow.ArrowException):
            continue
        yield from ((path, row) for row in rows)


def _place(item: tuple[Path, Row]) -> tuple[Any, ...]:
    return tuple(item[1][name] for name in KEYS)
