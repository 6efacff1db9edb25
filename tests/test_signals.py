"""Signals that ask a command to stop."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from jaxplore import _signals, cli
from jaxplore._signals import (
    ENDING,
    STOPPING,
    hold,
    interrupt_on_end_signals,
    is_ending,
    stop_requests,
)


@pytest.fixture(autouse=True)
def _as_before() -> Iterator[None]:
    """Give the process handlers that do nothing, and check that they are put back."""
    former = {each: signal.signal(each, _nothing) for each in STOPPING}
    try:
        yield
        assert {signal.getsignal(each) for each in STOPPING} == {_nothing}
    finally:
        for each, handler in former.items():
            signal.signal(each, handler)
        _signals._ending.clear()


def _nothing(*_: Any) -> None:
    pass


@pytest.mark.parametrize("number", STOPPING)
def test_each_signal_interrupts_a_command(number: int) -> None:
    with pytest.raises(KeyboardInterrupt), interrupt_on_end_signals():
        signal.raise_signal(number)
    assert is_ending() == (number in ENDING)
    with interrupt_on_end_signals():
        assert not is_ending()


@pytest.mark.parametrize("number", STOPPING)
def test_each_signal_is_a_request_where_a_loop_asks(number: int) -> None:
    with interrupt_on_end_signals(), stop_requests() as requested:
        assert not requested.is_set()
        signal.raise_signal(number)
        assert requested.is_set()
        # A closed terminal sends several. A second Ctrl-C is a person's.
        for other in ENDING:
            signal.raise_signal(other)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_a_terminal_that_ends_does_not_interrupt_the_saving(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    with interrupt_on_end_signals():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        for number in ENDING:
            signal.raise_signal(number)
        # Who still waits much later asks again.
        now += 3.0
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)


def test_signals_wait_for_the_end_of_what_holds_them() -> None:
    def remove(done: list[str]) -> None:
        with hold():
            for number in (*ENDING, signal.SIGINT, signal.SIGINT):
                signal.raise_signal(number)
            done.append("removed")

    done: list[str] = []
    with interrupt_on_end_signals():
        with pytest.raises(KeyboardInterrupt):
            remove(done)
        with hold():
            done.append("nothing came")
    assert done == ["removed", "nothing came"]


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with interrupt_on_end_signals(), hold():
        signal.raise_signal(signal.SIGHUP)
    assert signal.signal(signal.SIGHUP, _nothing) == signal.SIG_IGN
    assert not is_ending()


def test_an_interruption_in_a_callback_is_not_lost(capsys: pytest.CaptureFixture[str]) -> None:
    class Interrupted:
        def __del__(self) -> None:
            raise KeyboardInterrupt

    def run() -> None:
        with interrupt_on_end_signals():
            Interrupted()
            while True:
                time.sleep(0.01)

    with pytest.raises(KeyboardInterrupt):
        run()
    assert "Traceback" not in capsys.readouterr().err


def test_other_threads_have_no_handlers() -> None:
    found = []

    def run() -> None:
        with interrupt_on_end_signals(), hold(), stop_requests() as requested:
            found.append(requested.is_set())

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert found == [False]


PROGRAM = """
import os, signal, sys
from jaxplore import __main__ as program

class Press:
    def find_spec(self, name, path=None, target=None):
        if name == "jaxplore.cli":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Press())
program.main()
"""


def test_ctrl_c_during_the_import_is_one_line() -> None:
    run = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "jaxplore: interrupted\n")


@pytest.mark.parametrize(
    "error",
    [RuntimeError("CpuCallback error: KeyboardInterrupt: <string>"), "a cause", None],
)
def test_an_interruption_in_a_library_is_an_interruption(
    error: RuntimeError | str | None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(*_: object, **__: object) -> None:
        if isinstance(error, RuntimeError):
            raise error
        if error is None:
            raise RuntimeError("something else")
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt:
            raise RuntimeError(error)  # noqa: B904

    monkeypatch.setattr(cli.cli, "main", fail)
    if error is None:
        with pytest.raises(RuntimeError, match="something else"):
            cli.main([])
        return
    with pytest.raises(SystemExit) as stop:
        cli.main([])
    assert stop.value.code == 130
    assert capsys.readouterr().err == "jaxplore: interrupted\n"
