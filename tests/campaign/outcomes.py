"""What a call of the command line came to, and which outcomes are accepted."""

import enum
import signal
from typing import NamedTuple

from jaxplore._exit import BAD_INPUT, INTERRUPTED

MOST_SECONDS = 10.0
"""Longest time until bad input is refused [s]."""
MOST_BYTES = 2 * 2**30
"""Largest memory that a command with bad input takes [bytes]."""
LONGEST_LINE = 500
"""Longest message of an error [characters]."""
_PREFIX = "jaxplore: "
_TRACES = ("Traceback (most recent call last)", "Exception ignored", "Fatal Python error")


class Outcome(enum.StrEnum):
    """What a call came to."""

    ACCEPTED = "accepted"
    REFUSED = "refused in one line"
    STOPPED = "stopped, nothing half-written"
    TRACEBACK = "traceback"
    MESSAGE = "message of several lines, too long or unprintable"
    CODE = "wrong exit code"
    SLOW = "too slow"
    LARGE = "too much memory"
    BEGUN = "began what has no room"
    CHANGED = "refused, but files changed"
    LEFTOVER = "hidden leftovers"
    LOST = "former content lost or half-written"


_SIGNALS = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM)
_STOPPED = frozenset(
    {0, INTERRUPTED, -signal.SIGKILL}
    | {128 + each for each in _SIGNALS}
    | {-each for each in _SIGNALS}
)
GOOD = frozenset({Outcome.ACCEPTED, Outcome.REFUSED, Outcome.STOPPED})
"""Accepted outcomes."""


class Call(NamedTuple):
    """What was observed of a call.

    Args:
        code: exit code; negative for a signal, None if it was ended because it took too long.
        out: standard output.
        err: standard error.
        seconds: time that it took [s].
        size: largest memory that it took beyond the start [bytes].
        has_changed: whether files differ from before the call.
    """

    code: int | None
    out: str
    err: str
    seconds: float = 0.0
    size: int = 0
    has_changed: bool = False


class Judged(NamedTuple):
    """An outcome, with the reason in a few words."""

    outcome: Outcome
    reason: str = ""

    @property
    def is_good(self) -> bool:
        """Whether the outcome is accepted."""
        return self.outcome in GOOD


def judge(call: Call, most_seconds: float = MOST_SECONDS) -> Judged:
    """Return the outcome of a call with input that may be bad.

    Args:
        call: what was observed.
        most_seconds: time after which a refusal counts as too slow [s].
    """
    if any(each in call.err for each in _TRACES):
        return Judged(Outcome.TRACEBACK, _last_line(call.err))
    if call.size > MOST_BYTES:
        return Judged(Outcome.LARGE, f"{call.size / 2**30:.1f} GiB")
    if call.code is None or (call.code == BAD_INPUT and call.seconds > most_seconds):
        return Judged(Outcome.SLOW, f"{call.seconds:.1f} s")
    unprintable = {each for each in call.out + call.err if not (each.isprintable() or each == "\n")}
    if unprintable:
        return Judged(Outcome.MESSAGE, f"unprintable {sorted(unprintable)[:5]!r}")
    if call.code == 0:
        return Judged(Outcome.ACCEPTED)
    if call.code != BAD_INPUT:
        return Judged(Outcome.CODE, f"exit code {call.code}: {_last_line(call.err)}")
    lines = call.err.splitlines()
    if not lines or not lines[-1].startswith(_PREFIX):
        return Judged(Outcome.MESSAGE, f"no message: {call.err[:80]!r}")
    # Lines before the last one are what was found, such as a start that was chosen.
    if any(line.startswith(_PREFIX) for line in lines[:-1]):
        return Judged(Outcome.MESSAGE, f"{len(lines)} lines: {call.err[:80]!r}")
    if len(lines[-1]) > LONGEST_LINE:
        return Judged(Outcome.MESSAGE, f"{len(lines[-1])} characters: {lines[-1][:80]!r}")
    if call.has_changed:
        return Judged(Outcome.CHANGED, lines[-1])
    return Judged(Outcome.REFUSED, lines[-1])


def judge_stop(call: Call, *, is_whole: bool, leftovers: tuple[str, ...]) -> Judged:
    """Return the outcome of a command that was sent a signal.

    Args:
        call: what was observed.
        is_whole: whether every file is complete, and former content intact.
        leftovers: hidden files that it left behind, where none may be.
    """
    if any(each in call.err for each in _TRACES):
        return Judged(Outcome.TRACEBACK, _last_line(call.err))
    if call.code is None:
        return Judged(Outcome.SLOW, "did not end")
    # A command may end by itself before the signal arrives, or not listen to it yet.
    if call.code not in _STOPPED:
        return Judged(Outcome.CODE, f"exit code {call.code}: {_last_line(call.err)}")
    if not is_whole:
        return Judged(Outcome.LOST, f"exit code {call.code}")
    if leftovers:
        return Judged(Outcome.LEFTOVER, ", ".join(leftovers)[:200])
    return Judged(Outcome.ACCEPTED if call.code == 0 else Outcome.STOPPED)


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1][:200] if lines else ""
