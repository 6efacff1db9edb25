"""Machines without room: full disks, no place to write, nobody who reads."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from . import places
from .kills import state_of_recording
from .outcomes import Call, Judged, Outcome, judge
from .processes import file_limit, hidden, started

PATIENCE = 300.0
"""Longest wait for a command that does its work [s]."""
_RUN = ["run", "{base}/room.yaml", *places.FEW, "--time-limit", "0.5"]
WRITERS: dict[str, list[str]] = {
    "run": [*_RUN, "--out", "out"],
    "run with a recording": [*_RUN, "--out", "out", "--record", "r.mcap", "--no-animation"],
    "run with a video": [*_RUN, "--out", "out", "--video", "v.gif", "--no-animation"],
    "compare": [
        *("compare", "{base}/room.yaml", *places.FEW, "--time-limit", "0.5", "--seeds", "1"),
        *("--architectures", "explorer", "--no-animation", "--out", "out"),
    ],
    "compare maps": [*places.COMPARISON, "--time-limit", "1"],
    "tune": list(places.STUDY),
    "replay": ["replay", "{base}/bag", "--out", "out", "--no-animation"],
    "import-nav2": ["import-nav2", "{base}/nav2.yaml", "--out", "s.yaml"],
}
"""Commands that write files."""
SPEAKERS: dict[str, list[str]] = {
    "version": ["--version"],
    "help": ["run", "--help"],
    "settings": ["settings"],
    "a setting": ["settings", "robot"],
    "import-nav2": ["import-nav2", "{base}/nav2.yaml"],
    "run": [*_RUN, "--out", "out", "--no-animation"],
    "bad input": ["run", "office", "--seed", "-1"],
}
"""Commands that write to standard output."""
FILE_SIZES = (0, 100, 5_000, 50_000)
"""Sizes beyond which no file grows [bytes]."""


def machines(base: Path, root: Path) -> Iterator[tuple[str, str, Judged]]:
    """Yield a category, what was tried, and the outcome."""
    folder = root / "machine"

    def renew() -> Path:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        return folder

    for name, arguments in WRITERS.items():
        filled = places.filled(arguments, base)
        for size in FILE_SIZES:
            where = renew()
            with started(filled, where, prepare=file_limit(size)) as (_, finish):
                ended = finish(PATIENCE)
            yield "disk full", f"{name}, {size} bytes", _judge_full(ended, where)
    for label, variables in HOMES.items():
        for name in ("settings", "run", "bad input"):
            with started(places.filled(SPEAKERS[name], base), renew(), environment=variables) as (
                _,
                finish,
            ):
                ended = finish(PATIENCE)
            yield "home", f"{name}, {label}", judge(ended, PATIENCE)
    for name, arguments in SPEAKERS.items():
        filled = places.filled(arguments, base)
        for label in ("closed", "a pipe without a reader", "a full device"):
            yield "standard output", f"{name}, {label}", _deaf(filled, renew(), label)


HOMES: dict[str, dict[str, str | None]] = {
    "none": {"HOME": None, **dict.fromkeys(("XDG_CACHE_HOME", "JAXPLORE_CACHE"))},
    "missing": {"HOME": "/nonexistent", "XDG_CACHE_HOME": None, "JAXPLORE_CACHE": None},
    "read-only": {"HOME": "/proc", "XDG_CACHE_HOME": None, "JAXPLORE_CACHE": None},
    "a cache that is read-only": {"JAXPLORE_CACHE": "/proc/cache"},
    "a cache that is a file": {"JAXPLORE_CACHE": "/etc/hosts"},
}
"""Variables of homes in which nothing can be written. The administrator may write to folders
without rights, so these are places where nobody can."""


def _judge_full(ended: Call, folder: Path) -> Judged:
    """Judge a command whose files could not grow: nothing of its results may be half-written."""
    judged = judge(ended._replace(has_changed=False), PATIENCE)
    left = hidden(folder)
    if judged.is_good and left:
        return Judged(Outcome.LEFTOVER, ", ".join(left)[:200])
    if judged.outcome == Outcome.REFUSED:
        # Studies and comparisons keep what is finished, and a recording that is complete stays:
        # it is written before the folder of its run. All others leave nothing.
        try:
            whole = {"study", "comparison", *state_of_recording(folder)}
        except Exception as error:
            return Judged(Outcome.LOST, f"{type(error).__name__}: {error}"[:200])
        files = [path.name for path in folder.iterdir() if path.name not in whole]
        if files:
            return Judged(Outcome.CHANGED, f"{files}: {judged.reason}")
    return judged


def _deaf(arguments: list[str], folder: Path, label: str) -> Judged:
    """Run a command whose standard output nobody can read."""
    if label == "closed":
        with started(arguments, folder, prepare=lambda: os.close(1)) as (_, finish):
            ended = finish(PATIENCE)
    elif label == "a full device":
        with (
            open("/dev/full", "wb") as full,
            started(arguments, folder, stdout=full.fileno()) as (_, finish),
        ):
            ended = finish(PATIENCE)
    else:
        reader, writer = os.pipe()
        os.close(reader)
        try:
            with started(arguments, folder, stdout=writer) as (_, finish):
                ended = finish(PATIENCE)
        finally:
            os.close(writer)
    # Ended by a broken pipe, a command says nothing, as others do.
    if ended.code in (-13, 128 + 13) and not ended.err:
        return Judged(Outcome.STOPPED)
    return judge(ended._replace(has_changed=False), PATIENCE)
