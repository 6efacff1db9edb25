"""Identify the motors of a base from a drive: its commands, and its velocities by the odometry.

It is output-error identification (Ljung, System Identification, 1999, section 7.2): the model of
`Motors` is simulated from the commands alone, and its numbers are those of the least squares of
what the odometry says beside it.
"""

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplore.onboard.motors import Motors

STEP = 0.01
"""Step of the simulation [s]. A command has effect from within a step on, by its share of it."""
LONGEST_GAP = 0.5
"""Time without a command or a velocity after which the simulation begins anew [s]."""
LEAST_SECONDS, LEAST_CHANGES = 10.0, 8
"""Least time that is simulated [s], and least number of changes of a command of an axis."""
MOST_SAMPLES = 1_000_000
"""Greatest number of commands, and of velocities."""
LEAST_COMMANDED = 0.02
"""Root mean square of the commands of an axis that is in use [m/s, rad/s]."""
MOST_DELAY, MOST_LAG = 1.0, 3.0
"""Bounds of what is searched [s]."""
STARTS = ((0.02, 0.05), (0.1, 0.2), (0.3, 0.1), (0.1, 0.8), (0.6, 0.3))
"""Delays and lags from which the search begins [s]: it has several minima."""
LEVELS = 60
"""Number of ends of a dead zone that are tried at once."""
MOST_ZONE = 0.5
"""Share of the greatest command below which a dead zone ends."""
IS_BOUND = 0.98
"""Share of the greatest command below which a greatest velocity is one of the base."""
MOST_TRIES = 8
"""Greatest number of steps of the search from each start."""
MOST_TURNS = 4
"""Greatest number of turns of the search for numbers and dead zones."""
LEAST_IN_PIECE = 10
"""Least number of velocities of a piece without gaps."""


class Drive(NamedTuple):
    """Commands and velocities (vx, vy, omega) of a drive, each at its times [s], which rise.

    A command holds until the next one. Velocities are in the frame of the robot [m/s, m/s, rad/s].
    """

    command_times: Float[np.ndarray, " N"]
    commands: Float[np.ndarray, "N 3"]
    times: Float[np.ndarray, " M"]
    velocities: Float[np.ndarray, "M 3"]


class Identified(NamedTuple):
    """Motors that were identified.

    Args:
        motors: the motors; an axis that is not in use has no lag and no dead zone.
        is_used: (3,) axes whose commands change enough to tell.
        delay_error: standard error of the delay [s].
        lag_errors: (3,) standard errors of the lags [s].
        dead_zone_errors: (3,) half the widths of the intervals that hold the ends of the dead zones
            [m/s, m/s, rad/s].
        max_speed_errors: (3,) standard errors of the greatest velocities [m/s, m/s, rad/s]; NaN
            where no command asked for more.
        before: (3,) root mean square error of a velocity that is predicted to be the command.
        after: (3,) that of the velocity that is predicted by the motors.
        seconds: time that was simulated [s].
    """

    motors: Motors
    is_used: np.ndarray
    delay_error: float
    lag_errors: np.ndarray
    dead_zone_errors: np.ndarray
    max_speed_errors: np.ndarray
    before: np.ndarray
    after: np.ndarray
    seconds: float


def identify_motors(drive: Drive) -> Identified:
    """Identify the motors of a base from a drive.

    The delay is that of all axes; lag, dead zone and greatest velocity are those of each. The
    standard errors are those of least squares, where n residuals of a correlation r of neighbours
    count as n (1 - r) / (1 + r).

    Raises:
        ValueError: numbers that are not finite, times that do not rise, more than a million of
            either; less than 10 s with both; commands that hardly change.
    """
    _check(drive)
    pieces = _pieces(drive)
    seconds = sum(each.end - each.start for each in pieces)
    if seconds < LEAST_SECONDS:
        raise ValueError(
            f"commands and velocities overlap for {seconds:.1f} s; accepted: at least "
            f"{LEAST_SECONDS:g} s of driving"
        )
    is_used = np.array([_is_used(pieces, axis) for axis in range(3)])
    if not is_used.any():
        raise ValueError(
            f"commands change less than {LEAST_CHANGES} times on each axis; accepted: a drive that "
            "speeds up, brakes and turns"
        )
    fit = _Fit(pieces, np.flatnonzero(is_used).tolist())
    fit.search()
    return Identified(
        fit.motors,
        is_used,
        *fit.errors(),
        before=np.array([_rms(pieces, Motors(), axis) for axis in range(3)]),
        after=np.array([_rms(pieces, fit.motors, axis) for axis in range(3)]),
        seconds=seconds,
    )


class _Piece(NamedTuple):
    """A piece of a drive without gaps, from `start` to `end` [s]; `edges` are when its commands
    begin [s]."""

    start: float
    end: float
    edges: np.ndarray
    commands: np.ndarray
    times: np.ndarray
    velocities: np.ndarray

    def predict(self, motors: Motors, axis: int) -> np.ndarray:
        """Return the velocities of an axis at the times of the measured ones."""
        from scipy.signal import lfilter  # slow to import, and few need it

        number = max(2, math.ceil((self.end - self.start) / STEP) + 1)
        grid = self.start + STEP * np.arange(number)
        first = float(self.velocities[0, axis])
        # The mean of the command over each step, from its integral: a delay need not be a number
        # of steps, and the squares are smooth in it. Before its first command the base is steady.
        edges = np.concatenate([[self.start - MOST_DELAY - 1.0], self.edges, [grid[-1] + 1.0]])
        held = np.concatenate([[first], motors.limit(self.commands)[:, axis]])
        total = np.concatenate([[0.0], np.cumsum(held * np.diff(edges))])
        mean = np.diff(np.interp(grid - motors.delay, edges, total)) / STEP
        kept = math.exp(-STEP / max(float(motors.lag[axis]), 1e-6))
        after, _ = lfilter([1.0 - kept], [1.0, -kept], mean, zi=[kept * first])
        found: np.ndarray = np.interp(self.times, grid, np.concatenate([[first], after]))
        return found


class _Fit:
    """The search for the motors of some axes; `motors` are the best so far."""

    def __init__(self, pieces: list[_Piece], axes: list[int]) -> None:
        self._pieces, self._axes = pieces, axes
        self._commands = np.abs(np.concatenate([each.commands for each in pieces]))
        self._most = self._commands.max(axis=0)
        velocities = np.concatenate([each.velocities for each in pieces])
        # Axes of different units count by the share of their motion that is not explained.
        self._scale = np.maximum(np.sqrt(np.mean(velocities**2, axis=0)), LEAST_COMMANDED)
        self._fastest = np.abs(velocities).max(axis=0)
        self._zones = np.zeros(3)
        self._found: Any = None
        self.motors = Motors()

    def search(self) -> None:
        """Search by least squares from several starts, and for the dead zones in between.

        What a command in a dead zone does is no smooth function of its end, so the ends are tried.
        """
        fastest = np.minimum(self._fastest, self._most)[self._axes]
        starts = [np.array([delay, *[lag] * len(self._axes), *fastest]) for delay, lag in STARTS]
        for _ in range(MOST_TURNS):
            tried = [self._solve(each, MOST_TRIES) for each in starts]
            self._found = self._solve(min(tried, key=lambda each: float(each.cost)).x)
            self.motors = self._make(self._found.x)
            before = self._zones.copy()
            for axis in self._axes:
                self._zones[axis] = self._search_zone(axis)[0]
            starts = [self._found.x]
            if np.array_equal(before, self._zones):
                return
        self.motors = self._make(self._found.x)

    def _solve(self, start: np.ndarray, most: int | None = None) -> Any:
        """Return SciPy's result of the least squares from a start, after at most so many steps."""
        from scipy.optimize import least_squares

        number, fastest = len(self._axes), self._most[self._axes]
        low = np.concatenate([np.zeros(1 + number), 0.05 * fastest])
        high = np.concatenate([[MOST_DELAY], np.full(number, MOST_LAG), 1.01 * fastest])
        return least_squares(
            lambda numbers: self._residuals(self._make(numbers)),
            np.clip(start, low + 1e-6, high - 1e-6),
            bounds=(low, high),
            x_scale=np.concatenate([np.full(1 + number, 0.05), 0.1 * fastest]),
            diff_step=[1e-4],
            max_nfev=most,
        )

    def _make(self, numbers: np.ndarray, zones: np.ndarray | None = None) -> Motors:
        """Make motors of the numbers that least squares vary."""
        zones = self._zones if zones is None else zones
        number = len(self._axes)
        lag, top = np.zeros(3), np.full(3, math.inf)
        lag[self._axes] = numbers[1 : 1 + number]
        given = numbers[1 + number :]
        # A bound that no command asked for is not known.
        is_met = given < IS_BOUND * self._most[self._axes]
        top[self._axes] = np.where(is_met, np.maximum(given, zones[self._axes] + 1e-6), math.inf)
        return Motors(float(numbers[0]), lag.tolist(), zones.tolist(), top.tolist())

    def _residuals(self, motors: Motors) -> np.ndarray:
        parts = [
            (each.predict(motors, axis) - each.velocities[:, axis]) / self._scale[axis]
            for axis in self._axes
            for each in self._pieces
        ]
        return np.concatenate(parts)

    def _search_zone(self, axis: int) -> tuple[float, float]:
        """Return the end of the dead zone of an axis, and half the width of what it may be."""
        levels = np.unique(np.round(self._commands[:, axis], 6))
        levels = levels[levels < MOST_ZONE * self._most[axis]]
        # Between two commands that occur, each end does the same: the middle stands for it.
        edges = np.concatenate([[0.0], levels[levels > 0.0]])
        low, high = 0, len(edges) - 1
        while True:
            chosen = np.unique(
                np.linspace(low, high, min(LEVELS, high - low + 1)).round().astype(int)
            )
            squares = np.array([self._squares_with(axis, edges[each]) for each in chosen])
            best = int(np.argmin(squares))
            if high - low + 1 <= LEVELS:
                break
            low, high = int(chosen[max(best - 1, 0)]), int(chosen[min(best + 1, len(chosen) - 1)])
        count = self._count(axis)
        likely = chosen[squares <= squares[best] * (1.0 + 4.0 / count)]
        # The end is above the greatest command that does not move the base.
        ends = edges[max(int(likely[0]) - 1, 0)], edges[int(likely[-1])]
        if ends[0] == 0.0 and likely[0] <= 1:
            return 0.0, float(ends[1])
        return float(0.5 * (ends[0] + ends[1])), float(0.5 * (ends[1] - ends[0]))

    def _squares_with(self, axis: int, zone: float) -> float:
        """Return the sum of squares of an axis with a dead zone up to a command."""
        zones = self._zones.copy()
        zones[axis] = zone
        motors = self._make(self._found.x, zones)
        return float(
            sum(
                np.sum((each.predict(motors, axis) - each.velocities[:, axis]) ** 2)
                for each in self._pieces
            )
        )

    def _count(self, axis: int) -> float:
        """Return as how many independent ones the residuals of an axis count."""
        count = 0.0
        for each in self._pieces:
            errors = each.predict(self.motors, axis) - each.velocities[:, axis]
            errors = errors - errors.mean()
            power = float(np.sum(errors * errors))
            near = float(np.sum(errors[1:] * errors[:-1])) / power if power > 0.0 else 0.0
            near = min(max(near, 0.0), 0.999)
            count += len(errors) * (1.0 - near) / (1.0 + near)
        return max(count, 2.0)

    def errors(self) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        """Return the errors of the delay, lags, dead zones and bounds; see `Identified`."""
        found, number = self._found, len(self._axes)
        total = len(found.fun)
        counted = sum(self._count(axis) for axis in self._axes)
        variance = 2.0 * float(found.cost) / max(total - len(found.x), 1)
        covariance = np.linalg.pinv(found.jac.T @ found.jac) * variance * total / counted
        deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        lag, zone, top = np.full(3, np.nan), np.full(3, np.nan), np.full(3, np.nan)
        lag[self._axes] = deviations[1 : 1 + number]
        top[self._axes] = deviations[1 + number :]
        top[~np.isfinite(self.motors.max_speed)] = np.nan
        for axis in self._axes:
            zone[axis] = self._search_zone(axis)[1]
        return float(deviations[0]), lag, zone, top


def _check(drive: Drive) -> None:
    """Check the numbers of a drive."""
    for name, times, values in (
        ("commands", drive.command_times, drive.commands),
        ("velocities", drive.times, drive.velocities),
    ):
        if values.shape != (len(times), 3) or not 2 <= len(times) <= MOST_SAMPLES:
            raise ValueError(
                f"{name} have the shape {values.shape} at {len(times)} times; accepted: (N, 3) at "
                f"N times, 2 to {MOST_SAMPLES}"
            )
        if not (np.isfinite(times).all() and np.isfinite(values).all()):
            raise ValueError(f"{name} are not finite; accepted: finite numbers")
        if not (np.diff(times) > 0.0).all():
            raise ValueError(f"times of {name} do not rise; accepted: each later than the last")


def _pieces(drive: Drive) -> list[_Piece]:
    """Cut a drive where commands or velocities are missing.

    A base without commands is braked by a watchdog that nobody knows.
    """
    ends = [drive.command_times[np.flatnonzero(np.diff(drive.command_times) > LONGEST_GAP) + 1]]
    ends.append(drive.times[np.flatnonzero(np.diff(drive.times) > LONGEST_GAP) + 1])
    first = max(drive.command_times[0], drive.times[0])
    last = min(drive.command_times[-1] + LONGEST_GAP, drive.times[-1])
    cuts = np.unique(np.concatenate([[first], *ends, [np.nextafter(last, math.inf)]]))
    cuts = cuts[(cuts >= first) & (cuts <= np.nextafter(last, math.inf))]
    found = []
    for start, end in itertools.pairwise(cuts):
        times = (drive.times >= start) & (drive.times < end)
        given = np.flatnonzero((drive.command_times >= start) & (drive.command_times < end))
        # The command that holds at the start began before it.
        before = np.searchsorted(drive.command_times, start, side="right") - 1
        is_held = before >= 0 and start - drive.command_times[before] <= LONGEST_GAP
        if is_held and (not len(given) or given[0] != before):
            given = np.concatenate([[before], given])
        if not len(given):
            continue
        edges = np.maximum(drive.command_times[given], start)
        # What the last command does later than its time is not known.
        times &= drive.times <= edges[-1] + LONGEST_GAP
        if np.count_nonzero(times) < LEAST_IN_PIECE:
            continue
        measured = drive.times[times]
        piece = _Piece(
            float(measured[0]),
            float(measured[-1]),
            edges,
            drive.commands[given],
            measured,
            drive.velocities[times],
        )
        found.append(piece)
    return found


def _is_used(pieces: list[_Piece], axis: int) -> bool:
    """Check whether the commands of an axis change enough."""
    commands = [each.commands[:, axis] for each in pieces]
    changes = sum(int(np.count_nonzero(np.abs(np.diff(each)) > 1e-6)) for each in commands)
    size = math.sqrt(float(np.mean(np.concatenate(commands) ** 2)))
    return changes >= LEAST_CHANGES and size >= LEAST_COMMANDED


def _rms(pieces: list[_Piece], motors: Motors, axis: int) -> float:
    """Return the root mean square error of predicted velocities."""
    errors = [each.predict(motors, axis) - each.velocities[:, axis] for each in pieces]
    return math.sqrt(float(np.mean(np.concatenate(errors) ** 2)))
