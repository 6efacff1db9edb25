"""Results by commit and machine, under version control in `benchmarks/history`.

Two of them are compared row by row. A row knows the medians of parts of its measurement, taken one
after the other (`benchmarks.timing.percentiles`). It became slower or faster if the intervals of
these medians do not overlap and the ratio of the middle ones is more than `BOUND`. The first says
that the difference is more than what the machine did during a measurement, the second is for what a
shared machine does between two runs. The median of all ratios is told beside it: where it is far
from 1, the machine as a whole was faster or slower.
"""

import argparse
import json
import os
import platform
import re
import statistics
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.tables import Rows
from jaxplore._files import JSON_LIMIT, parse_json, read_bytes, replace_files
from jaxplore._text import error_reason, printable_path

FOLDER = Path(__file__).parent / "history"
BOUND = 1.25
"""Least ratio of two times that counts."""
DEPTH = 3
"""A file has a line for each row of a table of a section."""
FIELDS = {"commit", "date", "machine", "sections"}
"""Entries that results must have."""
Results = dict[str, Any]


def machine() -> str:
    """Return a name of the processor's model and the number of cores."""
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text(encoding="utf-8") if cpuinfo.exists() else ""
    model = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    name = model[1] if model else platform.processor() or platform.machine()
    return re.sub(r"[^a-z0-9]+", "-", f"{name} {os.cpu_count()}".lower()).strip("-")


def commit() -> str:
    """Return the commit that is checked out; `-dirty` is behind it where files have changed."""
    command = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    done = subprocess.run(
        command, cwd=Path(__file__).parent, stdout=subprocess.PIPE, text=True, check=False
    )
    return done.stdout.strip() or "unknown"


def default_path(results: Results) -> Path:
    """Return the file of results in the history."""
    day = results["date"][:10]
    return FOLDER / f"{day}-{results['commit']}-{results['machine']}.json"


def save(results: Results, path: Path) -> None:
    """Write results whole or not at all, numbers with six digits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_files([(path, (_text(_rounded(results), 0) + "\n").encode())])


def check_writable(path: Path) -> None:
    """Check that results can be written to a file, before they are measured.

    Raises:
        ValueError: a folder that cannot be made or written to, or a folder in place of a file.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        reason = "a folder has this name" if path.is_dir() else ""
    except OSError as error:
        reason = error_reason(error)
    if not reason and not os.access(path.parent, os.W_OK):
        reason = "its folder cannot be written to"
    if reason:
        raise ValueError(f"{printable_path(path)} cannot be written: {reason}")


def results_file(name: str) -> Path:
    """Return the path of a file for results; the type of an argument of `argparse`."""
    path = Path(name)
    try:
        check_writable(path)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return path


def load(path: Path) -> Results:
    """Read results.

    Raises:
        ValueError: a file that cannot be read or has no results.
    """
    data = read_bytes(path, "results of benchmarks", JSON_LIMIT)
    try:
        results: Results = parse_json(data)
    except ValueError as error:
        raise ValueError(f"{printable_path(path)}: {error}") from None
    if not isinstance(results, dict) or not set(results) >= FIELDS:
        accepted = f"an object with {', '.join(sorted(FIELDS))}"
        raise ValueError(
            f"{printable_path(path)} has no results of benchmarks; accepted: {accepted}"
        )
    return results


def newest(folder: Path = FOLDER, on: str | None = None) -> list[Results]:
    """Return the results of a folder, the newest first.

    Args:
        folder: folder of results.
        on: machine of the results; every machine when absent.
    """
    found = [load(path) for path in folder.glob("*.json")]
    chosen = [each for each in found if on in (None, each["machine"])]
    return sorted(chosen, key=lambda each: str(each["date"]), reverse=True)


def merged(found: list[Results]) -> Results:
    """Return the first of some results with all sections, each from the first that has it.

    A run of one section, on a machine with a GPU for example, then leaves the others as they are.

    Args:
        found: results, the newest first.
    """
    sections: dict[str, Any] = {}
    for each in found:
        sections = {**each["sections"], **sections}
    return {**found[0], "sections": sections}


def compare(old: Results, new: Results) -> tuple[Rows, str]:
    """Return a row for each time that became slower or faster, and a sentence on all of them.

    Raises:
        ValueError: they are of different machines, or have no time in common.
    """
    if old["machine"] != new["machine"]:
        raise ValueError(
            f"results of two machines, {old['machine']} and {new['machine']}, do not compare"
        )
    before, after = dict(_times(old)), dict(_times(new))
    shared = [key for key in after if key in before]
    if not shared:
        raise ValueError(f"{old['commit']} and {new['commit']} have no time in common")
    ratios, rows = [], []
    for key in shared:
        was, now = before[key], after[key]
        ratio = statistics.median(now) / statistics.median(was)
        ratios.append(ratio)
        apart = min(now) > max(was) or min(was) > max(now)
        if apart and max(ratio, 1.0 / ratio) > BOUND:
            change = "slower" if ratio > 1.0 else "faster"
            rows.append({"": key, "change": change, "times_as_long": ratio})
    said = (
        f"{len(rows)} of {len(shared)} times changed from {old['commit']} to {new['commit']}; "
        f"the median of all ratios is {statistics.median(ratios):.2f}"
    )
    return sorted(rows, key=lambda row: -float(row["times_as_long"])), said


def _times(results: Results) -> Iterator[tuple[str, list[float]]]:
    """Yield the repetitions of each row that has some, by the row's texts and first value."""
    for section, tables in results["sections"].items():
        for name, rows in tables.items():
            for row in rows:
                if row.get("repeats"):
                    first, *others = (value for key, value in row.items() if key != "repeats")
                    label = [first, *(each for each in others if isinstance(each, str))]
                    yield " / ".join(map(str, (section, name, *label))), row["repeats"]


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _rounded(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_rounded(each) for each in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _text(value: Any, depth: int) -> str:
    """Return JSON with a line for each value down to `DEPTH`."""
    if depth > DEPTH or not value or not isinstance(value, dict | list):
        return json.dumps(value, allow_nan=False)
    opening, closing = "{}" if isinstance(value, dict) else "[]"
    lines = (
        [f"{json.dumps(name)}: {_text(each, depth + 1)}" for name, each in value.items()]
        if isinstance(value, dict)
        else [_text(each, depth + 1) for each in value]
    )
    indent = "\n" + " " * depth
    return opening + ",".join(f"{indent} {line}" for line in lines) + indent + closing
