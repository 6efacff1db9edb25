"""Mutations of valid files of every format, by hypothesis."""

import copy
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from hypothesis import strategies as st

from . import kept, logs, volumes
from .contents import VALUES, encoded

PARTS = (
    *(b"\0", b"\xff" * 8, b"\x1b[31m", b"[/red]", b"-1", b"1e999", b"nan", b"null", b"&a ", b"*a"),
    *(b"\n", b"\t", b": ", b"- ", b"[", b"{", b"]", b"}", b'"', b"'", b"#", b"!!bool ", b"|", b"%"),
    *(b"9" * 40, b"\x7f\xff\xff\xff", b"PK\3\4", b"\x89PNG", b'{"op_code": ', b"PAR1"),
)
"""Bytes that mean something in one of the formats."""


class Format(NamedTuple):
    """A format, the valid file in the folder of valid files, and the command that reads it.

    Args:
        file: the valid file; a folder is copied whole before the file in it is mutated.
        arguments: the command, with the mutated copy in its working directory.
        is_tree: whether the entries of the file are mutated too, and not only its bytes.
        share: mutations by those of other formats; fewer where a process is started for each.
    """

    file: str
    arguments: Sequence[str]
    is_tree: bool = False
    share: float = 1.0


FORMATS = {
    "map": Format("map.yaml", ["run", "map.yaml", "--start", "1", "1.5", "0"], is_tree=True),
    "PGM": Format("maps/map.pgm", ["run", "maps/east.yaml", "--start", "1", "1.5", "0"]),
    "PNG": Format("maps/map.png", ["run", "maps/west.yaml", "--start", "1", "1.5", "0"]),
    "height map": Format(
        "height.png", ["run", "{base}/map.yaml", "--set", "terrain.height_map=height.png"]
    ),
    "world": Format("world.yaml", ["run", "world.yaml"], is_tree=True),
    "path": Format("path.yaml", ["run", "--path", "path.yaml"], is_tree=True),
    "CSV path": Format("path.csv", ["run", "--path", "path.csv"]),
    "settings": Format(
        "settings.yaml", ["run", "{base}/room.yaml", "--settings", "settings.yaml"], is_tree=True
    ),
    "node": Format("node.yaml", ["node", "--settings", "node.yaml"], is_tree=True),
    "starts": Format("maps/starts.yaml", ["compare", "--maps", "maps"], is_tree=True),
    "nav2": Format("nav2.yaml", ["import-nav2", "nav2.yaml"], is_tree=True),
    "metrics": Format("run/metrics.json", ["view", "run"]),
    "state": Format("run/state.npz", ["view", "run"]),
    "resumed": Format(
        "run/state.npz", ["run", "--resume", "run", "--time-limit", "9", "--overwrite"]
    ),
    "study": Format("study/study.jsonl", kept.LONGER_STUDY),
    "plan": Format("comparison/comparison.json", kept.LONGER_COMPARISON),
    "row": Format("comparison/runs/*.parquet", kept.LONGER_COMPARISON),
    "bag": Format("bag/bag.db3", ["replay", "bag"]),
    **{f"log {name}": Format(name, ["map-log", name]) for name in logs.KINDS},
    "bag of ROS 1": Format("drive.bag", ["replay", "drive.bag"]),
    "metadata of a bag": Format("bag/metadata.yaml", ["replay", "bag"], is_tree=True),
    "terrain": Format("terrain.npz", ["terrain", "terrain.npz"]),
    **{
        f"volume {each}": Format(f"room.{each}", volumes.arguments(each), share=0.1)
        for each in volumes.FILES
    },
}
"""Formats by name. `terrain` is no command of jaxplore: see `command.call`."""

EDITS = st.lists(
    st.tuples(
        st.sampled_from(["flip", "insert", "replace", "delete", "repeat", "cut"]),
        st.floats(0.0, 1.0),
        st.sampled_from(PARTS),
        st.integers(1, 400),
    ),
    min_size=1,
    max_size=5,
)
"""Edits of bytes: what, where as a share of the file, with which bytes, how many."""
CHANGES = st.lists(
    st.tuples(
        st.sampled_from(["set", "delete", "rename", "copy"]),
        st.integers(0, 200),
        st.sampled_from(list(VALUES.values())),
        st.integers(0, 200),
    ),
    min_size=1,
    max_size=4,
)
"""Changes of entries: what, which entry, the value, and another entry."""
MUTATIONS = st.tuples(st.booleans(), EDITS, CHANGES)


def mutated(data: bytes, mutation: tuple[bool, Any, Any], *, is_tree: bool) -> bytes:
    """Return a mutated file."""
    of_entries, edits, changes = mutation
    if not (is_tree and of_entries):
        return edited(data, edits)
    return yaml.safe_dump(_changed(yaml.safe_load(data), changes)).encode()


def edited(data: bytes, edits: Sequence[tuple[str, float, bytes, int]]) -> bytes:
    """Return bytes after some edits."""
    for what, share, part, number in edits:
        at = int(share * len(data))
        if what == "flip":
            data = (
                data[:at]
                + bytes([b ^ (1 << number % 8) for b in data[at : at + 1]])
                + data[at + 1 :]
            )
        elif what == "insert":
            data = data[:at] + part + data[at:]
        elif what == "replace":
            data = data[:at] + part + data[at + len(part) :]
        elif what == "delete":
            data = data[:at] + data[at + number :]
        elif what == "repeat":
            data = data[:at] + data[at : at + number] * 3 + data[at + number :]
        else:
            data = data[:at]
    return data


def _changed(tree: Any, changes: Sequence[tuple[str, int, Any, int]]) -> Any:
    for what, which, value, other in changes:
        slots = list(_slots(tree))
        if not slots:
            return tree
        holder, key = slots[which % len(slots)]
        if what == "delete":
            del holder[key]
        elif what == "rename" and isinstance(holder, dict):
            holder[str(value)[:40]] = holder.pop(key)
        elif what == "copy":
            source, name = slots[other % len(slots)]
            # Through text: an entry that holds itself would be an alias.
            holder[key] = yaml.safe_load(yaml.safe_dump(source[name]))
        else:
            # Of a value that is shared later changes would change all later files as well.
            holder[key] = copy.deepcopy(value)
    return tree


def _slots(tree: Any) -> Any:
    if isinstance(tree, dict | list):
        for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
            yield tree, key
            yield from _slots(tree[key])


def place(chosen: Format, mutation: tuple[bool, Any, Any], base: Path, folder: Path) -> None:
    """Put the mutated file into a folder, with the valid files beside it."""
    top, _, rest = chosen.file.partition("/")
    if rest:
        shutil.copytree(base / top, folder / top)
        file = min((folder / top).glob(rest))
    else:
        file = folder / top
        shutil.copy(base / top, file)
        if top == "map.yaml":
            (folder / "map.pgm").write_bytes(encoded("PPM"))
    file.write_bytes(mutated(file.read_bytes(), mutation, is_tree=chosen.is_tree))
