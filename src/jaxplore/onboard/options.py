"""What a pilot returns, and its numbers."""

import dataclasses
import enum
import math
from typing import NamedTuple

import numpy as np

from jaxplore import _checks, _kinds
from jaxplore.control.plausibility import MAX_AGE
from jaxplore.onboard.motors import Motors


class Mode(enum.StrEnum):
    """What a pilot does."""

    WAITING = "waiting"
    DRIVING = "driving"
    BRAKING = "braking"
    PAUSED = "paused"
    STOPPED = "stopped"
    DONE = "done"


class Command(NamedTuple):
    """A velocity command.

    Args:
        twist: (3,) velocity (vx, vy, omega) in the frame of the robot [m/s, m/s, rad/s].
        mode: what the pilot does.
        reason: why, in a few words; empty while it drives.
        scan_time: time of the scan that this command follows from; None without a new one [s].
    """

    twist: np.ndarray
    mode: Mode
    reason: str
    scan_time: float | None


@dataclasses.dataclass(frozen=True)
class PilotOptions:
    """Numbers of a pilot.

    Args:
        latency: time between a command and its effect [s], without the delay of the motors.
        max_age: greatest age of a scan or an odometry [s]; the robot brakes beyond it.
        max_frozen: greatest time in which equal scans or poses arrive although the robot should
            move [s].
        max_jump: greatest jump of the pose [m].
        max_look_age: greatest age of what the instrument of a part measures, such as the charge of
            a battery [s]; the robot brakes beyond it.
        max_deceleration: deceleration of the commands of a ramp to a stop [m/s^2]; the limits of
            the robot's base apply as well.
        max_angular_deceleration: angular deceleration of that ramp [rad/s^2].
        margin: distance from points of the scan that stopping must keep [m].
        done_after: time without a reachable place that is worth a visit after which the robot is
            done [s].
        returns: whether the robot then drives back to its first position.
        lidar_x: position of the lidar ahead of the robot's centre [m].
        lidar_y: position of the lidar to the left of it [m].
        is_obeyed: whether the robot executes the commands. In the replay of a drive it does not:
            every command starts from the measured state.
        motors: motors of the base, for which commands allow; they obey at once when absent.

    Raises:
        ValueError: a time or a rate that is not positive, a negative latency or margin, a position
            that is not finite.
    """

    latency: float = 0.05
    max_age: float = MAX_AGE
    max_frozen: float = 0.3
    max_jump: float = 0.5
    max_look_age: float = 30.0
    max_deceleration: float = 10.0
    max_angular_deceleration: float = 20.0
    margin: float = 0.03
    done_after: float = 3.0
    returns: bool = False
    lidar_x: float = 0.0
    lidar_y: float = 0.0
    is_obeyed: bool = True
    motors: Motors | None = None

    def __post_init__(self) -> None:
        _kinds.flag("is_obeyed", self.is_obeyed)
        _kinds.flag("returns", self.returns)
        if self.motors is not None:
            _kinds.instance("motors", self.motors, Motors)
        for name, value in vars(self).items():
            if name in ("lidar_x", "lidar_y"):
                _checks.number(name, value)
            elif name in ("latency", "margin"):
                _checks.number(name, value, at_least=0.0)
            elif name not in ("is_obeyed", "returns", "motors"):
                _checks.number(name, value, above=0.0)

    @property
    def time_to_effect(self) -> float:
        """Time between a command and its first effect, with the delay of the motors [s]."""
        return self.latency + (0.0 if self.motors is None else self.motors.delay)

    def slower(self, twist: np.ndarray, seconds: float) -> np.ndarray:
        """Return the velocity (3,) of a ramp to zero after some time [s]; its direction stays."""
        speed = math.hypot(*twist[:2])
        slower = max(0.0, speed - self.max_deceleration * seconds)
        scale = slower / speed if speed > 0.0 else 0.0
        turn = max(0.0, abs(twist[2]) - self.max_angular_deceleration * seconds)
        return np.append(scale * twist[:2], math.copysign(turn, twist[2]))
