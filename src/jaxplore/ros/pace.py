"""When the next command of a robot is due, by a real or a simulated clock."""

from jaxplore.onboard.drive_clock import STANDSTILL_SECONDS, Instant

LOOKS = 8
"""Number of looks at a simulated clock in a control period of real time: its rate is not known."""


class Pace:
    """Says when a command is due: a part of the control period [s] after the last one.

    With a simulated clock the period is simulated time, and real time while it stands still.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._last: Instant | None = None
        self._moved: Instant | None = None

    def begin(self, now: Instant) -> None:
        """Note a command."""
        self._last = now

    def is_due(self, share: float, now: Instant) -> bool:
        """Check whether a share of the control period has passed since the last command."""
        return self._time_left(share, now) <= 0.0

    def wait_for(self, share: float, now: Instant) -> float:
        """Return how long to wait before the next look [s]."""
        left = max(0.0, self._time_left(share, now))
        return min(left, self._period / LOOKS) if now.is_simulated else left

    def _time_left(self, share: float, now: Instant) -> float:
        """Return the time until a command is due, by the clock that counts [s]."""
        last = self._last
        if self._moved is None or self._moved.clock != now.clock:
            self._moved = now
        if last is None or last.is_simulated != now.is_simulated:
            return 0.0
        assert now.steady is not None
        assert last.steady is not None
        assert self._moved.steady is not None
        if not now.is_simulated or now.steady - self._moved.steady > STANDSTILL_SECONDS:
            return share * self._period - (now.steady - last.steady)
        if now.clock < last.clock:
            return 0.0
        return share * self._period - (now.clock - last.clock)
