"""The command line in this process, which ends where its work would begin."""

import contextlib
import io
import os
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any
from unittest import mock

import jaxplore.cli._map_log
import jaxplore.cli._node
import jaxplore.cli._run
import jaxplore.cli._view
import jaxplore.study.runner
from jaxplore._exit import BAD_INPUT
from jaxplore.cli import main
from jaxplore.maps.terrain import TerrainMap
from jaxplore.onboard.pilot import Pilot
from jaxplore.study.runner import Runner

from .outcomes import MOST_BYTES, MOST_SECONDS, Call

WAITS = 6.0
"""Greatest ratio of the time on the wall to the processor time of a call that is not ended."""
_EVERY = 0.1
"""Period of the looks at time and memory [s]."""
_AGAIN = 3.0
"""Time after which a call is ended again [s]."""
_ROOM = 2 * MOST_BYTES
"""Address space beyond that of the start, above which allocations fail [bytes]."""


class Begun(BaseException):
    """The input was accepted, and the work would begin."""


class OutOfBounds(BaseException):
    """A call took too long or too much memory."""


def begin(*_: Any, **__: Any) -> Any:
    """End the command: its input is accepted."""
    raise Begun


def _begin_tasks(_: Runner, tasks: Sequence[Any], __: Callable[..., None]) -> None:
    if tasks:
        raise Begun


@contextlib.contextmanager
def accepting() -> Iterator[None]:
    """Let every command end where it would simulate, compile, connect or serve."""
    with contextlib.ExitStack() as stack:
        for owner, name in (
            (jaxplore.cli._run, "simulate"),
            (jaxplore.cli._map_log, "map_log"),
            (jaxplore.cli._view, "Replay"),
            (jaxplore.cli._view, "LiveView"),
            (jaxplore.cli._node, "connect"),
            (Pilot, "prepare"),
        ):
            stack.enter_context(mock.patch.object(owner, name, begin))
        stack.enter_context(mock.patch.object(Runner, "run", _begin_tasks))
        yield


def call(
    arguments: Sequence[str], folder: Path, watched: Path, most_seconds: float = MOST_SECONDS
) -> Call:
    """Call the command line in a folder, within bounds of time and memory.

    Args:
        arguments: command-line arguments. `terrain FILE` reads a terrain map instead, which no
            command does.
        folder: working directory.
        watched: folder whose files are compared before and after.
        most_seconds: processor time after which the call is ended [s]. A machine may be shared, so
            the time that it may take on the wall is `WAITS` times as long.
    """
    # As a terminal has them: what cannot be encoded fails on standard output.
    out = io.TextIOWrapper(io.BytesIO(), "utf-8", "strict")
    err = io.TextIOWrapper(io.BytesIO(), "utf-8", "backslashreplace")
    before, code, began = files(watched), 0, time.process_time()
    bounds = _Bounds(most_seconds)
    with (
        contextlib.chdir(folder),
        # Warnings are told, as in the program, and are no errors, as in tests.
        warnings.catch_warnings(action="default"),
        accepting(),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            bounds.begin()
            _read_terrain(*arguments[1:]) if arguments[:1] == ["terrain"] else main(arguments)
        except Begun:
            pass
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 1
        except OutOfBounds:
            code = None  # type: ignore[assignment]
        except BaseException:
            code = 1
            err.write(traceback.format_exc())
        finally:
            bounds.end()
    seconds = time.process_time() - began
    has_changed = files(watched) != before
    return Call(code, _text(out), _text(err), seconds, bounds.size, has_changed)


def _read_terrain(path: str) -> None:
    """Read a terrain map, with an error of one line as a command has it."""
    try:
        TerrainMap.load(path)
    except ValueError as error:
        print(f"jaxplore: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)


def files(folder: Path) -> dict[str, tuple[int, int]]:
    """Return the size and the time of the last change of everything in a folder, by path."""
    found = {}
    for where, folders, names in os.walk(folder):
        for name in (*folders, *names):
            path = os.path.join(where, name)
            status = os.lstat(path)
            is_file = name in names
            found[path] = (status.st_size, status.st_mtime_ns) if is_file else (0, 0)
    return found


class _Bounds:
    """Raises `OutOfBounds` between its begin and its end, where a call takes too much.

    Args:
        most_seconds: greatest processor time [s].
    """

    def __init__(self, most_seconds: float) -> None:
        self.size = 0
        self._most_seconds, self._is_on = most_seconds, False
        self._wall, self._used = time.perf_counter(), time.process_time()
        self._first = _resident("VmRSS")

    def begin(self) -> None:
        """Look at time and memory from now on."""
        # The high-water mark of the process starts again.
        with contextlib.suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")
        self._limits = resource.getrlimit(resource.RLIMIT_AS)
        self._former = signal.signal(signal.SIGALRM, self._look)
        self._is_on = True
        signal.setitimer(signal.ITIMER_REAL, _EVERY, _EVERY)
        room = _resident("VmSize") + _ROOM
        resource.setrlimit(resource.RLIMIT_AS, (room, self._limits[1]))

    def end(self) -> None:
        """Look no more, and keep the greatest memory since the begin [bytes]."""
        self._is_on = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, self._former)
        resource.setrlimit(resource.RLIMIT_AS, self._limits)
        # The system's counts are rounded: its high-water mark may be below what a look found.
        self.size = max(_resident("VmHWM") - self._first, self.size)

    def _look(self, _: int, __: FrameType | None) -> None:
        if not self._is_on:
            return
        is_late = time.perf_counter() - self._wall > WAITS * self._most_seconds
        is_late |= time.process_time() - self._used > self._most_seconds
        self.size = max(_resident("VmRSS") - self._first, self.size)
        if is_late or self.size > MOST_BYTES:
            # Again later: Python ignores what is raised while it deletes an object.
            signal.setitimer(signal.ITIMER_REAL, _AGAIN, _AGAIN)
            raise OutOfBounds


def _resident(name: str) -> int:
    status = Path("/proc/self/status").read_bytes()
    _, _, rest = status.partition(name.encode() + b":")
    return 1024 * int(rest.split(None, 1)[0])


def _text(stream: io.TextIOWrapper) -> str:
    stream.flush()
    raw = stream.buffer
    assert isinstance(raw, io.BytesIO)
    return raw.getvalue().decode("utf-8", "backslashreplace")
