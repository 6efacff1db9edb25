"""Shortest paths of a car that drives forwards and backwards, in free space."""

import itertools
from collections.abc import Iterator

import numpy as np

Arc = tuple[np.ndarray | float, ...]
"""Lengths of the pieces of a path on circles of radius 1; infinite where there is none."""


def lengths(x: np.ndarray, y: np.ndarray, turn: np.ndarray, reversal: float) -> np.ndarray:
    """Return the costs (2, ...) of the ways to a pose, forwards first and backwards first.

    A cost is the length of the way, plus `reversal` for each change between forwards and backwards,
    the one at the start included if the way begins in the other direction. All lengths are in
    turning radii. The pose is x ahead of the car and y on its left, and `turn` is its heading
    relative to that of the car [rad].

    Source: Reeds and Shepp, "Optimal paths for a car that goes both forwards and backwards",
    Pacific Journal of Mathematics 1990, section 8.
    """
    cos, sin = np.cos(turn), np.sin(turn)
    best = np.full((2, *np.shape(x)), np.inf)
    # A way that is driven from its end to its start leads to the pose at which it began.
    for ends, x_to, y_to in ((1, x, y), (-1, x * cos + y * sin, x * sin - y * cos)):
        for drive in (1, -1):
            for side in (1, -1):
                # Mirrored ways lead to mirrored poses.
                mirrored = (drive * x_to, side * y_to, drive * side * turn)
                for gears, arcs in _words(*mirrored):
                    length = sum(np.abs(each) for each in arcs)
                    changes = sum(a != b for a, b in itertools.pairwise(gears))
                    first = drive * (gears if ends > 0 else gears[::-1])[0]
                    for row, direction in enumerate((1, -1)):
                        price = length + reversal * (changes + (direction != first))
                        best[row] = np.fmin(best[row], price)
    return best


def _words(x: np.ndarray, y: np.ndarray, turn: np.ndarray) -> Iterator[tuple[list[int], Arc]]:
    """Yield the gears and the pieces of the ways that begin forwards with a left circle.

    The names are the pieces: l and r are circles, s is straight, and a bar is a change of gear.
    Equations are those of the paper. Without a solution they are not numbers.
    """
    quarter = 0.5 * np.pi
    sin, cos = np.sin(turn), np.cos(turn)
    with np.errstate(invalid="ignore", divide="ignore"):
        # The circles at both ends are on the same side.
        far, angle = np.hypot(x - sin, y - 1.0 + cos), np.arctan2(y - 1.0 + cos, x - sin)
        # l s l, 8.1
        yield [1, 1, 1], (_whole(angle), far, _whole(turn - angle))
        # l | r | l and l | r l, 8.3 and 8.4
        wide = np.arccos(far / 4.0)
        first, middle = _whole(angle + quarter + wide), _whole(np.pi - 2.0 * wide)
        yield [1, -1, 1], (first, middle, _whole(turn - first - middle))
        yield [1, -1, -1], (first, middle, _whole(first + middle - turn))
        # l | r s l with a quarter of a circle, 8.9
        straight = np.sqrt(far**2 - 4.0) - 2.0
        first = _whole(angle + quarter + np.arctan2(2.0, straight + 2.0))
        rest = _whole(first - turn + quarter)
        yield [1, -1, -1, -1], (first, quarter, _positive(straight), rest)
        # They are on different sides.
        far, angle = np.hypot(x + sin, y - 1.0 - cos), np.arctan2(y - 1.0 - cos, x + sin)
        # l s r, 8.2
        straight = np.sqrt(far**2 - 4.0)
        first = _whole(angle + np.arctan2(2.0, straight))
        yield [1, 1, 1], (first, straight, _whole(first - turn))
        # l r | l r with two equal pieces, 8.7
        wide = np.where(far <= 2.0, np.arccos((far + 2.0) / 4.0), -np.arccos((far - 2.0) / 4.0))
        first, middle = _whole(angle + quarter + wide), np.where(far <= 2.0, wide, np.pi + wide)
        yield [1, 1, -1, -1], (first, middle, middle, _whole(turn - first + 2.0 * middle))
        # l | r l | r with two equal pieces, 8.8
        middle = np.arccos(np.where(far**2 <= 20.0, (20.0 - far**2) / 16.0, np.nan))
        first = _whole(angle + quarter + np.arcsin(2.0 * np.sin(middle) / far))
        yield [1, -1, -1, 1], (first, middle, middle, _whole(first - turn))
        # l | r s r with a quarter of a circle, 8.10
        first = _whole(angle + quarter)
        rest = _whole(turn - first - quarter)
        yield [1, -1, -1, -1], (first, quarter, _positive(far - 2.0), rest)
        # l | r s l | r with two quarters, 8.11
        straight = np.sqrt(far**2 - 4.0) - 4.0
        first = _whole(angle + quarter + np.arctan2(2.0, straight + 4.0))
        gears, rest = [1, -1, -1, -1, 1], _whole(first - turn)
        yield gears, (first, quarter, _positive(straight), quarter, rest)


def _whole(angle: np.ndarray) -> np.ndarray:
    """Return an angle as a way ahead, in [0, 2 pi)."""
    # A hair less than nothing is nothing, not a whole turn.
    turned = np.mod(angle, 2.0 * np.pi)
    return np.where(turned > 2.0 * np.pi - 1e-9, 0.0, turned)


def _positive(length: np.ndarray) -> np.ndarray:
    return np.where(length >= 0.0, length, np.nan)
