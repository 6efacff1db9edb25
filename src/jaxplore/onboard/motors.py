"""The motors of a base that obeys velocity commands."""

import contextlib
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxplore import _checks

AXES = ("vx", "vy", "omega")
"""Components of a velocity command in the frame of the robot [m/s, m/s, rad/s]."""


class Motors:
    """How the velocity of a base follows its command, on each axis by itself:

        u(t) = sat(dead(c(t - delay)))        v' = (u - v) / lag

    dead(c) is 0 where |c| is below `dead_zone`, and c elsewhere: a wheel that sticks does not turn,
    and what makes it turn is regulated to the command. sat clips to `max_speed`.

    The axes are vx and vy [m/s] and omega [rad/s]. A number stands for all three.

    Args:
        delay: time between a command and its first effect [s].
        lag: time constants of the axes [s]; 0 for an axis that obeys at once.
        dead_zone: least commands of the axes that move the base [m/s, m/s, rad/s].
        max_speed: greatest velocities of the axes [m/s, m/s, rad/s]; None where it has no bound.

    Raises:
        ValueError: a delay, lag or dead zone that is negative or not finite; a greatest velocity
            that is not above the dead zone of its axis.
    """

    def __init__(
        self,
        delay: float = 0.0,
        lag: float | Sequence[float] = 0.0,
        dead_zone: float | Sequence[float] = 0.0,
        max_speed: float | Sequence[float | None] | None = None,
    ) -> None:
        self.delay = _checks.number("delay", delay, at_least=0.0)
        self.lag, self.dead_zone = _axes("lag", lag), _axes("dead_zone", dead_zone)
        self.max_speed = _axes("max_speed", max_speed, absent=math.inf)
        if not (self.max_speed > self.dead_zone).all():
            raise ValueError(
                f"max_speed is {self.max_speed.tolist()} with a dead_zone of "
                f"{self.dead_zone.tolist()}; accepted: greater on each axis"
            )

    def __repr__(self) -> str:
        names = ("delay", "lag", "dead_zone", "max_speed")
        return f"Motors({', '.join(f'{name}={getattr(self, name)}' for name in names)})"

    def limit(self, command: np.ndarray) -> np.ndarray:
        """Return the velocity (..., 3) to which a command (..., 3) leads in the end."""
        moving = np.where(np.abs(command) >= self.dead_zone, command, 0.0)
        limited: np.ndarray = np.clip(moving, -self.max_speed, self.max_speed)
        return limited

    def respond(self, velocity: np.ndarray, command: np.ndarray, dt: float) -> np.ndarray:
        """Return the velocity (3,) after `dt` seconds in which a command (3,) has effect.

        v(t + dt) = u + k (v(t) - u)        k = exp(-dt / lag)
        """
        kept = self._kept(dt)
        after: np.ndarray = kept * velocity + (1.0 - kept) * self.limit(command)
        return after

    def command_for(self, velocity: np.ndarray, wanted: np.ndarray, dt: float) -> np.ndarray:
        """Return the command (3,) that leads from a velocity (3,) to a wanted one in `dt` seconds.

            c = (wanted - k velocity) / (1 - k)        k = exp(-dt / lag)

        It is the inverse of `respond`: it leads the wanted velocity by about `lag` times the wanted
        acceleration. It never has the other sign than that velocity: a base that brakes is not
        told to reverse. In the dead zone it becomes the nearer one of 0 and the end of the zone, so
        that a robot that shall creep does. It does not exceed `max_speed`.
        """
        kept = self._kept(dt)
        command = (wanted - kept * velocity) / (1.0 - kept)
        command = np.where(command * wanted > 0.0, command, 0.0)
        size = np.abs(command)
        end = np.where(size < 0.5 * self.dead_zone, 0.0, np.copysign(self.dead_zone, command))
        moving = np.where(size < self.dead_zone, end, command)
        limited: np.ndarray = np.clip(moving, -self.max_speed, self.max_speed)
        return limited

    def _kept(self, dt: float) -> np.ndarray:
        """Return the shares of a difference of velocities that are left after `dt` seconds."""
        kept: np.ndarray = np.exp(-dt / np.maximum(self.lag, 1e-9))
        return kept


def _axes(name: str, given: Any, *, absent: float | None = None) -> np.ndarray:
    """Return the numbers (3,) of the axes; None stands for `absent`, if that is given."""
    each = list(given) if isinstance(given, (list, tuple)) else [given] * 3
    values = np.full(3, np.nan)
    if len(each) == 3:
        filled = [absent if one is None else one for one in each]
        with contextlib.suppress(TypeError, ValueError):
            values = np.array(filled, np.float64)
    is_known = np.isfinite(values) | (values == absent)
    if values.shape != (3,) or not (is_known & (values >= 0.0)).all():
        raise ValueError(
            f"{name} is {given}; accepted: a number of at least 0, or three of the axes "
            f"{', '.join(AXES)}"
        )
    return values
