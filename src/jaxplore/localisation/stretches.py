"""Find where a stretch of the way lies in an old map, metres from where it is thought to be.

A single scan in a corridor looks like many others. The scans of a stretch together, with corners,
doors and junctions, seldom do. The search is exhaustive, and runs on the host.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

CELL = 0.25
"""Side of a cell of the grids that are compared [m]."""
RADIUS = 30.0
"""Distance from the end of a stretch beyond which its points are not used [m]."""
TURN_SPACING = 0.02
"""Spacing of the yaws that are tried [rad]: a cell at 12 m."""
BLUR, WIDEST_BLUR = 0.7, 5
"""Standard deviation and greatest reach of the blur of old points [cells]."""
APART = 1.0
"""Distance from the best position from which on another one is a rival [m]."""
_Floats = NDArray[np.float64]
_Grid = NDArray[np.float32]


class Patch(NamedTuple):
    """What scans say of their surroundings, in one frame.

    Args:
        occupied: (P, 2) ends of their beams [m].
        free: (F, 2) points that beams have passed [m].
    """

    occupied: _Floats
    free: _Floats

    @classmethod
    def of(
        cls, ranges: np.ndarray, is_return: np.ndarray, angles: np.ndarray, poses: np.ndarray
    ) -> "Patch":
        """Return the patch of S scans of B beams.

        Beams without a return are not used. Free points are two cells apart along a beam, and none
        is within two cells of its end.

        Args:
            ranges: (S, B) ranges [m].
            is_return: (S, B) which beams returned.
            angles: (B,) directions of the beams relative to the heading [rad].
            poses: (S, 3) poses of the scans in the frame of the patch.
        """
        directions = poses[:, 2:] + np.asarray(angles, float)
        along = np.stack([np.cos(directions), np.sin(directions)], axis=-1)
        ranges = np.where(is_return, ranges, 0.0).astype(float)
        begins = np.broadcast_to(poses[:, None, :2], along.shape)
        ends = (begins + ranges[..., None] * along)[np.asarray(is_return)]
        free = [np.zeros((0, 2))]
        for away in np.arange(CELL, max(float(ranges.max(initial=0.0)), CELL), 2.0 * CELL):
            is_passed = ranges > away + 2.0 * CELL
            free.append(begins[is_passed] + away * along[is_passed])
        return cls(ends, np.concatenate(free))


class PlaceOfPatch(NamedTuple):
    """Where a patch lies in another one.

    Args:
        pose: most likely pose (x, y, yaw) of its frame [m, m, rad].
        score: share of its cells that agree there, less those that are contradicted.
        rival: greatest score at a position more than a metre away.
        is_inside: whether the pose is inside of the poses that were tried, not at their edge.
    """

    pose: _Floats
    score: float
    rival: float
    is_inside: bool


def find_patch(
    patch: Patch, place: Patch, guess: np.ndarray, reach: float, most_turn: float
) -> PlaceOfPatch:
    """Return where a patch lies in an old map, the best of all poses around a guess.

    Both are drawn into grids: O and F are the occupied and the free cells of the patch, turned, and
    P and G those of the place. With B the blurred P, at most 1, the score of a shift s is

        sum over c of O(c) (B - G)(c + s) - F(c) P(c + s), divided by the number of cells of O

    for all shifts at once by the Fourier transform. Where walls are, B counts for it. A wall of
    the one where the other has seen free space counts against it. What only one has seen does not
    count. A free cell beside an occupied one is not free.

    Source: Olson, "Real-time correlative scan matching", ICRA 2009, for the exhaustive search;
    Konolige and Chou, "Markov localization using correlation", IJCAI 1999.

    Args:
        patch: the patch, in the frame whose pose is looked for.
        place: the old map, in the world.
        guess: pose (x, y, yaw) around which is searched [m, m, rad].
        reach: greatest shift along x and y [m].
        most_turn: greatest turn [rad].
    """
    import scipy.fft  # slow to import, and few need it

    number = 2 * int(np.ceil((RADIUS + reach) / CELL))
    size = scipy.fft.next_fast_len(number, real=True)
    walls, free = _draw(place, guess[:2], number)
    value = scipy.fft.rfft2(_blur(walls) - free, (size, size))
    occupied = scipy.fft.rfft2(walls, (size, size))
    steps, turns = int(np.ceil(reach / CELL)), int(np.ceil(most_turn / TURN_SPACING))
    shifts = np.arange(-steps, steps + 1)
    yaws = guess[2] + TURN_SPACING * np.arange(-turns, turns + 1)
    scores = np.zeros((len(yaws), len(shifts), len(shifts)), np.float32)
    for at, yaw in enumerate(yaws):
        cos, sin = np.cos(yaw), np.sin(yaw)
        turn = np.array([[cos, sin], [-sin, cos]])
        own, own_free = _draw(Patch(*(each @ turn for each in patch)), np.zeros(2), number)
        product = value * np.conj(scipy.fft.rfft2(own, (size, size)))
        product -= occupied * np.conj(scipy.fft.rfft2(own_free, (size, size)))
        found = scipy.fft.irfft2(product, (size, size))[np.ix_(shifts, shifts)]
        scores[at] = found / max(float(own.sum()), 1.0)
    best = np.unravel_index(int(scores.argmax()), scores.shape)
    yaw, right, up = (int(each) for each in best)
    away = CELL * np.hypot(shifts[:, None] - shifts[right], shifts - shifts[up])
    others = scores.max(axis=0)[away > APART]
    pose = np.array([*(guess[:2] + CELL * shifts[[right, up]]), yaws[yaw]])
    is_inside = bool(0 < yaw < len(yaws) - 1 and max(abs(shifts[right]), abs(shifts[up])) < steps)
    return PlaceOfPatch(pose, float(scores[best]), float(others.max(initial=0.0)), is_inside)


def _draw(patch: Patch, middle: np.ndarray, number: int) -> tuple[_Grid, _Grid]:
    """Return the occupied and the free cells of a patch, in grids around a point."""
    from scipy.ndimage import maximum_filter  # slow to import, and few need it

    grids = []
    for points in patch:
        cells = np.floor((points - middle) / CELL).astype(int) + number // 2
        cells = cells[((cells >= 0) & (cells < number)).all(axis=1)]
        grid = np.zeros((number, number), np.float32)
        grid[cells[:, 0], cells[:, 1]] = 1.0
        grids.append(grid)
    walls, free = grids
    return walls, free * (maximum_filter(walls, 3) == 0.0)


def _blur(walls: _Grid) -> _Grid:
    """Return occupied cells that fade to the sides, 1 on them."""
    from scipy.ndimage import gaussian_filter  # slow to import, and few need it

    alone = np.zeros((2 * WIDEST_BLUR + 1,) * 2, np.float32)
    alone[WIDEST_BLUR, WIDEST_BLUR] = 1.0
    greatest = float(gaussian_filter(alone, BLUR).max())
    blurred: _Grid = np.minimum(gaussian_filter(walls, BLUR) / greatest, 1.0)
    return blurred
