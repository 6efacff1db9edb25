"""Damages of what the commands keep: run folders, studies, comparisons, terrains and bags."""

import functools
import io
import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from . import places
from .contents import Found

LONGER_STUDY = [*places.STUDY, "--budget", "5"]
LONGER_COMPARISON = [*places.COMPARISON, "--seeds", "3"]
READERS: dict[str, list[list[str]]] = {
    "run": [
        ["view", "run"],
        ["run", "--resume", "run", "--time-limit", "9", "--overwrite", "--no-animation"],
    ],
    "study": [LONGER_STUDY],
    "comparison": [LONGER_COMPARISON],
    "bag": [["replay", "bag"]],
}
"""Commands that continue or show a folder of each kind."""
FILES = {
    "run": ["metrics.json", "state.npz", "settings.yaml"],
    "study": ["study.jsonl", "settings.yaml", "record.yaml"],
    "comparison": ["comparison.json", "results.parquet", "runs/*.parquet"],
    "bag": ["metadata.yaml", "bag.db3"],
}
"""Files that the commands read again."""


def copied(kind: str, damage: Callable[[Path], None]) -> Callable[[Path], None]:
    """Return a function that copies a valid folder and damages the copy."""

    def prepare(folder: Path) -> None:
        shutil.copytree(folder.parent / places.BASE / kind, folder / kind)
        damage(folder / kind)

    return prepare


def changed(pattern: str, change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    """Return a damage that changes the content of the first file of a pattern."""

    def damage(folder: Path) -> None:
        file = min(folder.glob(pattern))
        file.write_bytes(change(file.read_bytes()))

    return damage


CHANGES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda _: b"",
    "half of": lambda data: data[: len(data) // 2],
    "all but the end of": lambda data: data[:-7],
    "twice": lambda data: data + data,
    "zeros for": lambda data: bytes(len(data)),
    "a text for": lambda _: b"other",
    "JSON of a list for": lambda _: b"[1, 2]",
    "JSON of nothing for": lambda _: b"{}",
    "deep JSON for": lambda _: b"[" * 100_000,
    "a number of JSON for": lambda _: b"1" * 10_000,
    "not UTF-8 for": lambda _: b"\xff\xfe\x00\x80",
    "a hole in": lambda data: data[: len(data) // 3] + bytes(64) + data[len(data) // 3 + 64 :],
    "a text in": lambda data: data[: len(data) // 3] + b"<html>" * 20 + data[len(data) // 3 :],
    "upside down": lambda data: data[::-1],
}
"""Changes of the bytes of any file."""


def damages() -> Found:
    """Yield damages of every kind of kept data, for each command that reads it."""
    for kind, commands in READERS.items():
        for command in commands:
            label = f"{command[0]} {kind}"
            for pattern in FILES[kind]:
                for name, change in CHANGES.items():
                    damage = changed(pattern, change)
                    yield f"{label}: {name} {pattern}", command, copied(kind, damage)
                yield f"{label}: no {pattern}", command, copied(kind, _without(pattern))
                yield f"{label}: a folder as {pattern}", command, copied(kind, _folder(pattern))
            for name, damage in _own(kind):
                yield f"{label}: {name}", command, copied(kind, damage)


def _without(pattern: str) -> Callable[[Path], None]:
    return lambda folder: min(folder.glob(pattern)).unlink()


def _folder(pattern: str) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        file = min(folder.glob(pattern))
        file.unlink()
        file.mkdir()

    return damage


def _own(kind: str) -> list[tuple[str, Callable[[Path], None]]]:
    """Return the damages that suit the formats of one kind of folder."""
    if kind == "run":
        return [*_of_json("metrics.json"), *_of_npz("state.npz")]
    if kind == "comparison":
        return [*_of_json("comparison.json"), *_of_parquet()]
    if kind == "study":
        return _of_study()
    return []


STRANGE: tuple[Any, ...] = (None, True, -1, 1e400, 10**400, "x", [], {}, [[1]], "\ud800")


def _of_json(name: str) -> list[tuple[str, Callable[[Path], None]]]:
    """Return damages that replace or remove entries of a JSON file, one after the other."""
    found = []
    for index in range(14):
        for number, value in enumerate(STRANGE[index % 2 :: 2]):

            def damage(folder: Path, index: int = index, value: Any = value) -> None:
                document = json.loads((folder / name).read_text())
                key = sorted(document)[index % len(document)]
                document[key] = value
                (folder / name).write_text(json.dumps(document))

            found.append((f"{name} with a strange entry {index}, {number}", damage))

        def remove(folder: Path, index: int = index) -> None:
            document = json.loads((folder / name).read_text())
            del document[sorted(document)[index % len(document)]]
            (folder / name).write_text(json.dumps(document))

        found.append((f"{name} without entry {index}", remove))
    return found


def npy(header: bytes, data: bytes = b"", version: bytes = b"\1\0") -> bytes:
    """Return an array file with any header."""
    return b"\x93NUMPY" + version + len(header).to_bytes(2, "little") + header + data


HEADERS = {
    "an open header": b"{'descr': '<f4', 'shape': (3,",
    "an open text": b"{'descr': '<f4",
    "an indented header": b"  {\n 'descr'\n  :'<f4'",
    "a header of a call": b"__import__('os').getcwd()",
    "a header of bytes": b"\xff\xfe\x00",
    "a deep header": b"(" * 3000,
    "an object": b"{'descr': '|O', 'fortran_order': False, 'shape': (1,)}",
    "a huge array": b"{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000,)}",
    "a huger array": b"{'descr': '<f8', 'fortran_order': False, 'shape': (10**30,)}",
    "a negative array": b"{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}",
    "a type of 1 GB": b"{'descr': '|V1000000000', 'fortran_order': False, 'shape': (9,)}",
    "a type of nothing": b"{'descr': '|V0', 'fortran_order': False, 'shape': (10000000000,)}",
    "fields": b"{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (1,)}",
    "a strange type": b"{'descr': [1], 'fortran_order': False, 'shape': (1,)}",
    "a strange shape": b"{'descr': '<f4', 'fortran_order': False, 'shape': ('a',)}",
    "dates": b"{'descr': '<M8[s]', 'fortran_order': False, 'shape': (0,)}",
}


def archive(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """Return a zip archive."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as file:
        for name, data in members.items():
            file.writestr(name, data)
    return stream.getvalue()


def arrays(**changes: Any) -> bytes:
    """Return an archive of arrays."""
    stream = io.BytesIO()
    np.savez(stream, **changes)
    return stream.getvalue()


@functools.cache
def npz_files() -> dict[str, bytes]:
    """Return archives of which none holds sensible arrays."""
    found = {name: archive({"structure.npy": npy(each)}) for name, each in HEADERS.items()}
    found |= {
        "no member": archive({}),
        "a member that is no array": archive({"structure.npy": b"text"}),
        "another version": archive({"structure.npy": npy(b"{}", version=b"\3\0")}),
        "a bomb": archive({"structure.npy": bytes(20_000_000)}),
        "bzip2": archive({"structure.npy": b"x"}, zipfile.ZIP_BZIP2),
        "an empty structure": arrays(structure=np.zeros(0, np.uint8)),
        "a structure of numbers": arrays(structure=np.arange(9.0)),
        "a structure of JSON": arrays(structure=np.frombuffer(b'{"kind": "X"}', np.uint8)),
        "a deep structure": arrays(structure=np.frombuffer(b"[" * 99_999, np.uint8)),
        "a path as a member": archive({"../../x.npy": npy(b"{}")}),
        "many members": archive({f"a{i}.npy": b"" for i in range(3000)}),
    }
    return found


def _of_npz(name: str) -> list[tuple[str, Callable[[Path], None]]]:
    found = [
        (f"{name} with {label}", changed(name, lambda _, data=data: data))  # type: ignore[misc]
        for label, data in npz_files().items()
    ]
    for label, header in HEADERS.items():

        def damage(folder: Path, header: bytes = header) -> None:
            """Replace the header of one array and keep the others."""
            with zipfile.ZipFile(folder / name) as file:
                members = {each: file.read(each) for each in file.namelist()}
            last = max(members)
            (folder / name).write_bytes(archive({**members, last: npy(header)}))

        found.append((f"{name} with {label} among arrays", damage))
    return found


def _of_parquet() -> list[tuple[str, Callable[[Path], None]]]:
    """Return damages of the file of a run: columns of other types, missing and strange values."""
    found = []
    for column, value in (
        *(("map", "[/red]\x1b[31m"), ("explorer", None), ("seed", -5), ("coverage", None)),
        *(("duration", None), ("error", "x" * 9000), ("settings", "{"), ("versions", "[1]")),
        *(("curve_time", []), ("curve_coverage", None), ("seen", b"no image"), ("format", 99)),
        *(("area_under_curve", float("nan")), ("id", "../../x"), ("positions_x", [1e308] * 3)),
    ):

        def strange(folder: Path, column: str = column, value: Any = value) -> None:
            import pyarrow
            import pyarrow.parquet

            file = min(folder.glob("runs/*.parquet"))
            table = pyarrow.parquet.read_table(file)
            rows = [{**row, column: value} for row in table.to_pylist()]
            pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows, schema=table.schema), file)

        def missing(folder: Path, column: str = column) -> None:
            import pyarrow.parquet

            file = min(folder.glob("runs/*.parquet"))
            table = pyarrow.parquet.read_table(file)
            pyarrow.parquet.write_table(table.drop_columns([column]), file)

        def typed(folder: Path, column: str = column) -> None:
            import pyarrow
            import pyarrow.parquet

            file = min(folder.glob("runs/*.parquet"))
            table = pyarrow.parquet.read_table(file)
            lists = pyarrow.array([[{"a": 1}]] * len(table))
            index = table.schema.get_field_index(column)
            pyarrow.parquet.write_table(table.set_column(index, column, lists), file)

        found += [
            (f"a row with a strange {column}", strange),
            (f"a row without {column}", missing),
            (f"a row with a {column} of another type", typed),
        ]
    return found


def _of_study() -> list[tuple[str, Callable[[Path], None]]]:
    """Return damages of the lines of a study: left out by kind, and with strange values."""
    found: list[tuple[str, Callable[[Path], None]]] = []

    def doing(change: Callable[[dict[str, Any]], list[Any]]) -> Callable[[Path], None]:
        def damage(folder: Path) -> None:
            file = folder / "study.jsonl"
            lines = [json.loads(line) for line in file.read_text().splitlines()]
            changed = [json.dumps(new) for line in lines for new in change(line)]
            file.write_text("".join(f"{line}\n" for line in changed))

        return damage

    for operation in range(10):
        found.append(
            (
                f"no operation {operation}",
                doing(lambda line, o=operation: [line] * (line["op_code"] != o)),
            )
        )
        found.append(
            (
                f"operation {operation} twice",
                doing(lambda line, o=operation: [line] * (1 + (line["op_code"] == o))),
            )
        )
    for name in (
        *("op_code", "worker_id", "study_id", "trial_id", "study_name", "directions", "state"),
        *("values", "value", "user_attr", "system_attr", "system_attrs", "param_name"),
        *("param_value_internal", "distribution", "distributions", "params", "datetime_start"),
        *("datetime_complete", "step", "intermediate_value"),
    ):
        for value in ("x", 9, None, [1]):

            def strange(line: dict[str, Any], name: str = name, value: Any = value) -> list[Any]:
                return [line | {name: value} if name in line else line]

            found.append((f"{name} is {str(value)[:20]}", doing(strange)))
        found.append(
            (f"no {name}", doing(lambda line, n=name: [{k: v for k, v in line.items() if k != n}]))
        )
    found.append(("a deep line", lambda folder: _append(folder, "[" * 50_000)))
    found.append(("a line of a list", lambda folder: _append(folder, "[1]")))
    found.append(("half a line", lambda folder: _append(folder, '{"op_code": 4', end="")))
    return found


def _append(folder: Path, text: str, end: str = "\n") -> None:
    with (folder / "study.jsonl").open("a") as file:
        file.write(text + end)
