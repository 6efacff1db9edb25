"""Signals that ask a process to stop, handled in one way everywhere.

Ctrl-C sends SIGINT, an administrator or a container SIGTERM, a closed terminal SIGHUP. In a command
all three ask for the same: to stop and to keep what is done. A second Ctrl-C stops at once.

Python runs handlers in the main thread only; in other threads nothing here has an effect.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType
from typing import Any

from jaxplore._exit import INTERRUPTED

type Handler = Callable[[int, FrameType | None], Any]

ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals of a process or a terminal that ends this one; Windows has no SIGHUP."""
STOPPING = (signal.SIGINT, *ENDING)
"""Signals that ask this process to stop."""

SAME_REQUEST = 2.0
"""Time within which SIGTERM and SIGHUP are one request [s]: a terminal or a service manager that
ends sends several."""
LOST_AGAIN = 0.05
"""Time after which an interruption that was lost in a callback is sent again [s]."""

_ending = threading.Event()


def is_ending() -> bool:
    """Check whether SIGTERM or SIGHUP has asked the command to stop.

    Their senders wait for some seconds only and kill then, so work that can be left out is.
    """
    return _ending.is_set()


def end_at_once() -> None:
    """End this process at once when it is asked to stop, until something else handles that.

    It is for a program that imports its modules or shuts down: there is nothing to keep. An
    exception would not do. It may come up in a callback, where Python prints a traceback and goes
    on.
    """
    for number in STOPPING:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _end)


def _end(_: int, __: FrameType | None) -> None:
    try:
        # Not through `sys.stderr`, which the interrupted code may be writing to.
        os.write(2, b"jaxplore: interrupted\n")
    finally:
        os._exit(INTERRUPTED)


@contextmanager
def interrupt_on_end_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP do what Ctrl-C does in the body, which is a whole command."""
    _ending.clear()
    last = -SAME_REQUEST

    def pass_on(number: int, frame: FrameType | None) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < SAME_REQUEST:
            return
        last = now
        _ending.set()
        # The loops of a run have their own handler of Ctrl-C, which ends them in order.
        handler = signal.getsignal(signal.SIGINT)
        if not callable(handler):
            raise KeyboardInterrupt
        handler(number, frame)

    handlers = {signal.SIGINT: signal.default_int_handler, **dict.fromkeys(ENDING, pass_on)}
    with _handle(handlers), _resend_lost():
        yield


@contextmanager
def stop_requests() -> Iterator[threading.Event]:
    """Yield an event that Ctrl-C sets; a second Ctrl-C raises `KeyboardInterrupt`.

    In the body of `interrupt_on_end_signals` SIGTERM and SIGHUP set it as well.
    """
    requested = threading.Event()

    def request(number: int, _: FrameType | None) -> None:
        if requested.is_set() and number == signal.SIGINT:
            raise KeyboardInterrupt
        requested.set()

    # A process in the background of a script ignores Ctrl-C, but not what calls this handler.
    with _handle({signal.SIGINT: request}, are_ignored_too=True):
        yield requested


@contextmanager
def hold() -> Iterator[None]:
    """Hold signals back until the end of the body, such as a removal of files."""
    received: list[int] = []
    try:
        with _handle(dict.fromkeys(STOPPING, lambda number, _: received.append(number))):
            yield
    finally:
        for number in received[:1]:
            signal.raise_signal(number)


@contextmanager
def block_in_children() -> Iterator[None]:
    """Block Ctrl-C while processes start: they never receive it, this process receives it later.

    A terminal sends the signal to all processes, but only this one shall end the workers.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _resend_lost() -> Iterator[None]:
    """Send an interruption again that came up in a callback, where Python prints it and goes on."""
    former = sys.unraisablehook

    def hook(lost: "sys.UnraisableHookArgs") -> None:
        if lost.exc_type is not KeyboardInterrupt:
            former(lost)
            return
        timer = threading.Timer(LOST_AGAIN, os.kill, (os.getpid(), signal.SIGINT))
        timer.daemon = True
        timer.start()

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = former


@contextmanager
def _handle(handlers: Mapping[int, Handler], *, are_ignored_too: bool = False) -> Iterator[None]:
    """Handle signals by number in the body; outside of the main thread, leave them as they are.

    With `are_ignored_too`, handle also signals that the process was started to ignore, as SIGHUP
    under `nohup`.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before: dict[int, Any] = {}
    try:
        for number, handler in handlers.items():
            if are_ignored_too or signal.getsignal(number) != signal.SIG_IGN:
                before[number] = signal.signal(number, handler)
        yield
    finally:
        for number, former in before.items():
            # None is a handler that Python has not installed, and cannot install again.
            if former is not None:
                signal.signal(number, former)
