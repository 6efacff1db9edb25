"""Changes of what a pilot does, which wait until they are told."""

from collections import deque

from jaxplore.onboard.options import Command

MOST_WAITING = 64
"""Number of changes that wait; the oldest goes first."""


class Changes:
    """Keeps the commands whose mode or kind of reason is not that of the command before.

    A reason may last for one control period, and the thread that tells it may be busy for longer:
    what is only read now and then says nothing of it. Commands come from one thread, and another
    one takes the changes.
    """

    def __init__(self) -> None:
        self._waiting: deque[Command] = deque(maxlen=MOST_WAITING)
        self._last: tuple[str, str] | None = None

    def add(self, command: Command) -> None:
        """Keep a command if it is a change."""
        kind = kind_of(command)
        if kind != self._last:
            self._last = kind
            self._waiting.append(command)

    def take(self) -> list[Command]:
        """Return the changes since the last call, the oldest first."""
        return [self._waiting.popleft() for _ in range(len(self._waiting))]


def kind_of(command: Command) -> tuple[str, str]:
    """Return the mode, and what the reason begins with: the rest has numbers that change."""
    return str(command.mode), command.reason[:12]
