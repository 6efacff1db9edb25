"""Commands as processes: started, given little room, and killed."""

import contextlib
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from .command import files
from .outcomes import Call

_PROGRAM = """
import os
os.write(int(os.environ["CAMPAIGN_READY"]), b"x")
from jaxplore.__main__ import main
main()
"""
"""The command, which says that Python has started: what comes before is not jaxplore's."""


@contextlib.contextmanager
def started(
    arguments: Sequence[str],
    folder: Path,
    *,
    environment: Mapping[str, str | None] | None = None,
    stdout: int | None = None,
    prepare: Callable[[], None] | None = None,
) -> Iterator[tuple[subprocess.Popen[bytes], Callable[[float], Call]]]:
    """Start a command; yield its process, and a function that waits for it and tells the end.

    Args:
        arguments: command-line arguments.
        folder: working directory.
        environment: variables that differ from this process's; None removes one.
        stdout: file descriptor for standard output; a pipe that is read when absent.
        prepare: called in the new process before it runs the command.
    """
    ready, say = os.pipe()
    variables = {**os.environ, "CAMPAIGN_READY": str(say)}
    for name, value in (environment or {}).items():
        variables.pop(name, None)
        if value is not None:
            variables[name] = value
    before, began = files(folder), time.perf_counter()
    # Pipes and no files: what lets no file grow lets messages through.
    process = subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, *arguments],
        cwd=folder,
        env=variables,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE if stdout is None else stdout,
        stderr=subprocess.PIPE,
        pass_fds=[say],
        preexec_fn=lambda: _prepare(prepare),
        start_new_session=True,
    )
    os.close(say)
    os.read(ready, 1)
    os.close(ready)

    def finish(most_seconds: float) -> Call:
        code: int | None = None
        try:
            both = process.communicate(timeout=most_seconds)
            code = process.returncode
        except subprocess.TimeoutExpired:
            end(process)
            both = process.communicate()
        seconds = time.perf_counter() - began
        out, err = (
            "" if each is None else each.decode("utf-8", "backslashreplace") for each in both
        )
        return Call(code, out, err, seconds, 0, files(folder) != before)

    try:
        yield process, finish
    finally:
        end(process)
        for pipe in (process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()


def _prepare(further: Callable[[], None] | None) -> None:
    """Prepare a new process before it runs a command."""
    # What a script starts in the background ignores Ctrl-C, under `nohup` also SIGHUP, and so would
    # the command.
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    if further is not None:
        further()


def end(process: subprocess.Popen[bytes]) -> None:
    """End a process and all that it has started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def file_limit(size: int) -> Callable[[], None]:
    """Return a function that lets no file grow beyond a size, as a full disk does [bytes]."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def hidden(folder: Path) -> tuple[str, ...]:
    """Return the hidden files and folders anywhere in a folder."""
    return tuple(
        sorted(
            os.path.relpath(os.path.join(where, name), folder)
            for where, folders, names in os.walk(folder)
            for name in (*folders, *names)
            if name.startswith(".")
        )
    )
