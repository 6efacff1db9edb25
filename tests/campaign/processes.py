"""Commands as processes: started, given little room, and killed."""

import contextlib
import os
import resource
import signal
import subprocess
import sys
import tempfile
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
        stdout: file descriptor for standard output; a file that is read when absent.
        prepare: called in the new process before it runs the command.
    """
    ready, say = os.pipe()
    variables = {**os.environ, "CAMPAIGN_READY": str(say)}
    for name, value in (environment or {}).items():
        variables.pop(name, None)
        if value is not None:
            variables[name] = value
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        before, began = files(folder), time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, *arguments],
            cwd=folder,
            env=variables,
            stdin=subprocess.DEVNULL,
            stdout=out if stdout is None else stdout,
            stderr=err,
            pass_fds=[say],
            preexec_fn=prepare,
            start_new_session=True,
        )
        os.close(say)
        os.read(ready, 1)
        os.close(ready)

        def finish(most_seconds: float) -> Call:
            code: int | None = None
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = process.wait(most_seconds)
            seconds = time.perf_counter() - began
            end(process)
            for file in (out, err):
                file.seek(0)
            texts = [file.read().decode("utf-8", "backslashreplace") for file in (out, err)]
            return Call(code, texts[0], texts[1], seconds, 0, files(folder) != before)

        try:
            yield process, finish
        finally:
            end(process)


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
