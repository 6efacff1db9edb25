"""The file of a run folder from which a run is loaded: all fields of its recording."""

import contextlib
import dataclasses
import importlib
import json
import math
import re
import types
import typing
from collections import namedtuple
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxplore._files import parse_json, read_bytes
from jaxplore._text import error_reason, printable_path, short_repr
from jaxplore.maps.files.npz import MALFORMED_NPZ, read_arrays
from jaxplore.report.compute import Timing
from jaxplore.report.folder import MARK
from jaxplore.report.metrics import Metrics
from jaxplore.report.part import PartReport
from jaxplore.report.recording import Frame, Recording

NAME = "state.npz"
"""Name of the file."""
FILE_LIMIT = 2**30
"""Largest file that is read [bytes]."""
CONTENT_LIMIT = 2**31
"""Largest content of such a file, unpacked [bytes]."""
METRICS_LIMIT = 2**24
"""Largest `metrics.json` that is read [bytes]."""
_OF_A_PART = re.compile(r"jaxplore\.parts\.[a-z_]+\.report")
"""Modules that a file may name: what a run shows of the parts of the package."""


def pack_recording(recording: Recording) -> dict[str, np.ndarray]:
    """Return arrays that hold a recording, for `unpack_recording`.

    `structure` is JSON: the class, and its fields with their numbers and texts. Arrays are apart.
    Frames are stacked.
    """
    arrays: dict[str, np.ndarray] = {}
    fields = {field.name: getattr(recording, field.name) for field in dataclasses.fields(recording)}
    frames = fields.pop("frames")
    stacked: dict[str, Any] = {}
    if frames:
        stacked = jax.tree.map(lambda *rows: np.stack(rows), *[vars(frame) for frame in frames])
    structure = {
        "kind": type(recording).__name__,
        "fields": {name: _pack(value, f"fields/{name}", arrays) for name, value in fields.items()},
        "frame": type(frames[0]).__name__ if frames else None,
        "num_frames": len(frames),
        "frames": {name: _pack(rows, f"frames/{name}", arrays) for name, rows in stacked.items()},
    }
    return arrays | {"structure": np.frombuffer(json.dumps(structure).encode(), np.uint8)}


def _pack(value: Any, path: str, arrays: dict[str, np.ndarray]) -> Any:
    """Return JSON of a value, and put the arrays in it into `arrays`."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return {"value": value}
    if isinstance(value, (np.ndarray, np.generic, jax.Array)):
        arrays[path] = np.asarray(value, order="C")
        return {"array": path}
    if isinstance(value, PartReport):
        kind = {"part": type(value).__name__, "module": type(value).__module__}
        return {**kind, "fields": _pack_all(vars(value), path, arrays)}
    if isinstance(value, Timing):
        return {"fields": _pack_all(vars(value), path, arrays)}
    if hasattr(value, "_asdict"):
        return {"fields": _pack_all(value._asdict(), path, arrays)}
    if isinstance(value, Mapping):
        return {"mapping": _pack_all(value, path, arrays)}
    if isinstance(value, (tuple, list)):
        return {"items": [_pack(each, f"{path}/{i}", arrays) for i, each in enumerate(value)]}
    raise ValueError(
        f"{path} of the recording is {short_repr(value)}; accepted: arrays, numbers, texts, None, "
        "and tuples of them"
    )


def _pack_all(values: Mapping[str, Any], path: str, arrays: dict[str, np.ndarray]) -> Any:
    return {name: _pack(value, f"{path}/{name}", arrays) for name, value in values.items()}


def load_run[T](
    path: str | PathLike[str],
    build: Callable[[Recording, Metrics, Mapping[str, np.ndarray]], T],
) -> T:
    """Read a run folder, and build an object from it.

    `build` is given the recording, its metrics and all arrays of the state file. The metrics are
    computed from the recording again.
    """
    folder = Path(path)
    report = read_bytes(folder / MARK, "a run folder with this", METRICS_LIMIT)
    data = read_bytes(folder / NAME, "a run folder with this", FILE_LIMIT)
    try:
        arrays, noted = _read_limited(data), parse_json(report, METRICS_LIMIT)
        recording = unpack_recording(arrays)
        versions = {str(name): value for name, value in noted["versions"].items()}
        metrics = recording.metrics(seed=_seed(noted["seed"]))
        return build(recording, dataclasses.replace(metrics, versions=versions), arrays)
    except (*MALFORMED_NPZ, MemoryError) as error:
        raise ValueError(
            f"{printable_path(folder)} cannot be loaded ({error_reason(error)}); accepted: a run "
            "folder as Run.save writes it"
        ) from None


def _read_limited(data: bytes) -> dict[str, np.ndarray]:
    left = CONTENT_LIMIT

    def check(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        nonlocal left
        left -= math.prod(shape) * dtype.itemsize
        if left < 0:
            raise ValueError(f"it holds more than {CONTENT_LIMIT} bytes")

    return read_arrays(data, check)


def _seed(value: Any) -> int | None:
    if value is None or (isinstance(value, int) and not isinstance(value, bool)):
        return value
    raise ValueError(f"seed is {short_repr(value)}")


def unpack_recording(arrays: Mapping[str, np.ndarray]) -> Recording:
    """Return the recording that `pack_recording` stored.

    Its class, and that of its frames, are looked up among those that are imported.
    """
    structure = parse_json(arrays["structure"].tobytes(), METRICS_LIMIT)
    kind = _find_class(Recording, structure["kind"])
    hints = typing.get_type_hints(kind)
    fields = {
        name: _unpack(value, hints.get(name, Any), arrays)
        for name, value in structure["fields"].items()
    }
    _check_fields(kind, {**fields, "frames": ()})
    if len({len(rows) for rows in jax.tree.leaves(fields["records"])}) > 1:
        raise ValueError("its records differ in length")
    fields["records"] = _name_parts(fields["records"], fields.get("parts", {}))
    recording: Recording = kind(**fields, frames=_frames(structure, arrays))
    return recording


def _frames(structure: Any, arrays: Mapping[str, np.ndarray]) -> tuple[Frame, ...]:
    if not structure["num_frames"]:
        return ()
    stacked = {name: _unpack(each, Any, arrays) for name, each in structure["frames"].items()}
    frame = _find_class(Frame, structure["frame"])
    _check_fields(frame, stacked)
    return tuple(
        frame(**jax.tree.map(lambda rows, i=i: _on_host(rows[i]), stacked))
        for i in range(structure["num_frames"])
    )


def _find_class(base: type, name: object) -> Any:
    """Return the subclass of a name, or the class itself."""
    classes, found = [base], {}
    while classes:
        each = classes.pop()
        found[each.__name__] = each
        classes += each.__subclasses__()
    if name not in found:
        raise ValueError(f"its {base.__name__} {short_repr(name)} is of a module not imported")
    return found[name]


def _check_fields(kind: Any, given: Mapping[str, Any]) -> None:
    fields = dataclasses.fields(kind)
    # A field with a default may be newer than the file.
    needed = {each.name for each in fields if not _has_default(each)}
    wrong = (set(given) - {each.name for each in fields}) | (needed - set(given))
    if wrong:
        names = ", ".join(sorted(wrong))
        raise ValueError(f"fields of {kind.__name__} are missing or unknown: {names}")


def _has_default(field: dataclasses.Field[Any]) -> bool:
    missing = dataclasses.MISSING
    return field.default is not missing or field.default_factory is not missing


def _unpack(packed: Any, hint: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """Return the value of `_pack`, checked against its type hint."""
    value: Any
    if "array" in packed:
        value = arrays[packed["array"]]
    elif "items" in packed:
        inner = _entry_hint(hint)
        value = tuple(_unpack(each, inner, arrays) for each in packed["items"])
    elif "mapping" in packed:
        value = {name: _unpack(each, Any, arrays) for name, each in packed["mapping"].items()}
    elif "part" in packed:
        return _make_part(packed, arrays)
    elif "fields" in packed:
        return _make_record(packed["fields"], hint, arrays)
    else:
        value = packed["value"]
    plain = [typing.get_origin(each) or each for each in _options(hint)]
    is_checked = Any not in plain and all(isinstance(each, type) for each in plain)
    # Whole numbers may be written for floats.
    accepted = (*plain, int) if float in plain else tuple(plain)
    if is_checked and not isinstance(value, accepted):
        raise ValueError(f"a field is {short_repr(value)} and not of type {hint}")
    return value


def _make_part(packed: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> PartReport:
    """Return what a run shows of a part; its class is looked up among those that are imported.

    A part of the package is imported first: reading a run needs no part but its own.
    """
    module = packed.get("module")
    if isinstance(module, str) and _OF_A_PART.fullmatch(module):
        with contextlib.suppress(ModuleNotFoundError):
            importlib.import_module(module)
    kind = _find_class(PartReport, packed["part"])
    hints = typing.get_type_hints(kind)
    fields = {
        name: _unpack(value, hints.get(name, Any), arrays)
        for name, value in packed["fields"].items()
    }
    _check_fields(kind, fields)
    report: PartReport = kind(**fields)
    return report


def _name_parts(records: Any, parts: Mapping[str, PartReport]) -> Any:
    """Return records with those of parts in classes of their own."""
    types = {name: each.record_type for name, each in parts.items() if each.record_type is not None}
    if not types:
        return records
    named = {name: make(**records.parts[name]._asdict()) for name, make in types.items()}
    return records._replace(parts={**records.parts, **named})


def _make_record(fields: Mapping[str, Any], hint: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """Return a NamedTuple or a `Timing` of the class in the hint, by default a `Record`."""
    for kind in _options(hint):
        if kind is Timing:
            return Timing(**{n: _unpack(v, Any, arrays) for n, v in fields.items()})
        if isinstance(kind, type) and hasattr(kind, "_fields"):
            hints = typing.get_type_hints(kind)
            # The hints are of one step on the device, so only classes within are of use.
            inner = {name: _tuples(each) for name, each in hints.items()}
            return kind(**{n: _unpack(v, inner.get(n, Any), arrays) for n, v in fields.items()})
    make: Any = namedtuple  # the names are known at run time only
    return make("Record", list(fields))(
        **{name: _unpack(value, Any, arrays) for name, value in fields.items()}
    )


def _options(hint: Any) -> tuple[Any, ...]:
    is_union = typing.get_origin(hint) in (types.UnionType, typing.Union)
    return typing.get_args(hint) if is_union else (hint,)


def _entry_hint(hint: Any) -> Any:
    """Return the class of the records in a tuple of them, else any."""
    for each in _options(hint):
        of = typing.get_args(each)
        if typing.get_origin(each) is tuple and hasattr(of[0], "_fields"):
            return of[0]
    return Any


def _tuples(hint: Any) -> Any:
    found = [each for each in _options(hint) if hasattr(each, "_fields")]
    return found[0] | None if found else Any


def _on_host(value: Any) -> Any:
    array = np.asarray(value)
    return array if array.ndim else array.item()
