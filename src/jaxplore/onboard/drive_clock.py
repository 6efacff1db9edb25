"""The time of a drive, which never goes back, and when in it a message was true."""

import math
from typing import NamedTuple

from jaxplore import _checks

MAX_STEP = 0.2
"""Greatest step of a clock that is no jump [s], such as one of NTP."""
CLOCK_TOLERANCE = 1.0
"""Greatest difference between a stamp and the clock; beyond it clocks are not synchronised [s]."""
MOST_BETWEEN = 1.0
"""Longest time between two readings that is taken to have passed, where only a clock that may jump
tells it [s]."""
MOST_RATE = 20.0
"""Greatest rate of a simulated clock, in simulated seconds a second."""
STANDSTILL_SECONDS = 0.5
"""Real time after which a simulated clock that shows the same time stands still [s]."""


class Instant(NamedTuple):
    """A moment, read from two clocks at once.

    `clock` is the time of the clock of the stamps [s], which may jump. `steady` is that of
    `time.monotonic` [s], which does not; None where only the clock of the stamps is known, as in a
    recording. The clock of a simulator, `is_simulated`, may also pause, and run faster or slower.
    """

    clock: float
    steady: float | None = None
    is_simulated: bool = False

    @classmethod
    def of(cls, now: "float | Instant") -> "Instant":
        """Return a moment; a number, which must be finite, is the clock of the stamps alone."""
        if isinstance(now, Instant):
            return now
        return cls(_checks.number("now", now))


class DriveClock:
    """Tells the time of a drive [s], which never goes back and never jumps.

    It begins at the first reading of the clock of the stamps. Then it passes as the steady clock
    does. Without one, or with a simulated clock, it passes as the clock of the stamps does.

    The clock of the stamps jumps if its step cannot be the time that has passed, which is

    - with a steady clock: the time by that clock, within `MAX_STEP`;
    - with a simulated clock: at most `MOST_RATE` times the real time since it last moved;
    - without a steady clock: at most `MOST_BETWEEN`.

    A step back by more than `MAX_STEP` is always a jump. In a jump one control period passes.

    `jump` says by how much the clock jumped at the last reading; None if it did not. `is_standing`
    is whether a simulated clock stands still.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        # The last reading, the one at which its clock had last moved, and the time of the drive.
        self._last: tuple[Instant, Instant, float] | None = None
        self.jump: str | None = None
        self.is_standing = False

    @property
    def time(self) -> float:
        """Time of the drive at the last reading [s]; NaN before the first."""
        return math.nan if self._last is None else self._last[2]

    def advance(self, at: Instant) -> float:
        """Read the clocks; return the time of the drive that has passed [s]."""
        self.jump, self.is_standing = None, False
        if self._last is None:
            self._last = at, at, at.clock
            return self._period
        last, moved, time = self._last
        seconds = self._since(at)
        if seconds is None:
            away = at.clock - last.clock
            if not at.is_simulated and at.steady is not None and last.steady is not None:
                away -= at.steady - last.steady
            self.jump = f"the clock jumped by {away:.1f} s"
        passed = self._period if seconds is None else max(0.0, seconds)
        if at.clock != moved.clock or at.steady is None or moved.steady is None:
            moved = at
        else:
            stood = at.steady - moved.steady
            self.is_standing = at.is_simulated and stood > STANDSTILL_SECONDS
        self._last = at, moved, time + passed
        return passed

    def time_at(self, at: Instant) -> float | None:
        """Return the time of the drive at a moment near the last reading [s]; None where the clock
        has jumped in between."""
        if self._last is None:
            self.advance(at)
        seconds = self._since(at)
        return None if seconds is None else self.time + seconds

    def arrival(self, stamp: float, received: Instant | None) -> tuple[float, float]:
        """Return when a message arrived, by the clock of the stamps and in the drive [s].

        Without `received` it is the time of its stamp, but not before the last reading, and at most
        a control period after it.
        """
        if received is not None:
            time = self.time_at(received)
            return received.clock, self.time if time is None else time
        if self._last is None:
            self.advance(Instant(stamp))
        assert self._last is not None
        (clock, *_), _, time = self._last
        since = min(max(stamp - clock, 0.0), self._period)
        return clock + since, time + since

    def _since(self, at: Instant) -> float | None:
        """Return the time since the last reading [s]; None where the clock has jumped."""
        assert self._last is not None
        last, moved, _ = self._last
        step = at.clock - last.clock
        least, most, passed = 0.0, MOST_BETWEEN - MAX_STEP, step
        if at.is_simulated != last.is_simulated:
            return None
        if at.steady is not None and last.steady is not None and moved.steady is not None:
            if at.is_simulated:
                # Simulated clocks move in steps, which may be seldom.
                most = MOST_RATE * min(at.steady - moved.steady, MOST_BETWEEN)
            else:
                least = most = passed = at.steady - last.steady
        return passed if least - MAX_STEP <= step <= most + MAX_STEP else None


class Stamps:
    """Tells when in a drive the messages of a topic were true, by their stamps and arrivals.

    If the clock of the sender agrees with this one, a message was true at its stamp, or at its
    arrival where the stamp is later. If it does not agree, a message was true when it arrived.

    The clocks agree once a stamp is within `CLOCK_TOLERANCE` of its arrival. A message that is late
    by more does not change that. They do not agree if the first stamp is farther off, a stamp is 0
    or stamps go back, until one is within the tolerance again.

    Of two messages the one that was true later is newer. A stamp that is more than a control period
    ahead of its arrival is an error: messages that arrive after it are not older for it.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self.forget()

    def forget(self) -> None:
        """Forget all messages: the clock has jumped."""
        self._stamp, self._newest, self._is_synchronised = math.inf, -math.inf, True

    def time_of(self, stamp: float, clock: float, time: float) -> float | None:
        """Return when in the drive a message was true [s]; None if it is older than another.

        `clock` is its arrival by the clock of the stamps, and `time` that in the drive [s].
        """
        age = clock - stamp
        # Some drivers leave the stamp at 0.
        if stamp != 0.0 and abs(age) <= CLOCK_TOLERANCE:
            self._is_synchronised = True
        elif stamp == 0.0 or stamp < self._stamp - MAX_STEP:
            # That of the first message as well.
            self._is_synchronised = False
        self._stamp = stamp
        found = time - max(age, 0.0) if self._is_synchronised else time
        if found < self._newest:
            return None
        if age >= -self._period:
            self._newest = found
        return found
