"""Where the metres of a run go: kinds of metres that do not overlap.

The run is looked at from scan to scan. `gain` is the area that a scan made free for the first time
[m^2], recomputed with the project's own sensor from the recorded poses.

1. **Dithering.** The time is cut into windows of `WINDOW` seconds. Where the path of a window is
   longer than the shortest way between its ends over the reachable cells, each of its metres counts
   as dithering for the share

       1 - shortest way / path

   and with the rest of the share as one of the other kinds. Bends that a robot makes because it
   cannot turn faster count as well.

2. The path is cut into pieces of `PIECE` metres. A piece is *dry* if it gains less than `DRY`
   m^2/m. Dry pieces in a row that are at least `LEAST` metres long are a *dry stretch*. It ends
   where the next piece gains something. Its metres are

   - **return**, if the robot had passed near to the place where it ends: if the way from the path
     driven before to that place and back is at most as long as the stretch. The path counts up to
     `AGO` metres before the stretch, so that a way ahead is none. The robot had passed a pocket,
     left it and comes back. What the stretch is longer than this detour is the *price* of the
     return: what the robot would have saved by seeing the pocket when it passed.
   - **transit** otherwise, and if nothing is gained until the end.

3. **Sliver**: the other pieces that gain less than `THIN` m^2/m, shorter dry ones included.

4. **Gain**: all other metres.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

WINDOW = 3.0
"""Length of a window [s]."""
PIECE, LEAST, AGO = 0.5, 1.0, 3.0
"""Length of a piece, least length of a dry stretch, and path before it that does not count [m]."""
DRY, THIN = 0.1, 0.5
"""Gains below which a piece is dry, and a sliver [m^2/m]."""
SLOW = 0.9
"""Share of the greatest speed below which the robot counts as slow."""
KINDS = ("gain", "sliver", "return", "transit", "dithering")
"""Kinds of metres."""


@dataclasses.dataclass(frozen=True, eq=False)
class Steps:
    """A run from scan to scan: K steps between K + 1 scans.

    Args:
        places: (K + 1, 2) positions of the scans [m].
        gain: (K + 1,) area that each scan makes free for the first time [m^2].
        metres: (K,) lengths of the driven path between the scans [m].
        period: time between two scans [s].
    """

    places: np.ndarray
    gain: np.ndarray
    metres: np.ndarray
    period: float


@dataclasses.dataclass(frozen=True, eq=False)
class Split:
    """Kinds of the metres of a run.

    Args:
        kind: (K,) kind of each step without its dithering, an index into `KINDS`.
        dithering: (K,) share of each step that is dithering.
        metres: (K,) length of each step [m].
        price: (K,) price of the return that ends with each step, 0 for others [m].
    """

    kind: np.ndarray
    dithering: np.ndarray
    metres: np.ndarray
    price: np.ndarray

    def lengths(self, first: int = 0, last: int | None = None) -> dict[str, float]:
        """Return the metres of each kind from one step to another; they add up to the path [m]."""
        part = slice(first, last)
        metres, share, kind = self.metres[part], self.dithering[part], self.kind[part]
        lengths = {
            name: float((metres * (1.0 - share))[kind == index].sum())
            for index, name in enumerate(KINDS[:-1])
        }
        return {**lengths, KINDS[-1]: float((metres * share).sum())}


def split_metres(
    steps: Steps,
    shortest: Callable[[int, int], float],
    detour: Callable[[int, int], float],
) -> Split:
    """Tell the kind of each step; see the module.

    Args:
        steps: the run.
        shortest: function that returns the shortest way between the places of two scans [m].
        detour: function that returns the shortest way to the place of a scan from the path up to
            another scan [m].
    """
    count = len(steps.metres)
    dithering, kind, price = np.zeros(count), np.zeros(count, np.int64), np.zeros(count)
    size = max(1, round(WINDOW / steps.period))
    for first in range(0, count, size):
        last = min(first + size, count)
        length = float(steps.metres[first:last].sum())
        if length > 0.0:
            dithering[first:last] = np.clip(1.0 - shortest(first, last) / length, 0.0, 1.0)
    bounds = _pieces(steps.metres)
    lengths = np.array([steps.metres[a:b].sum() for a, b in bounds])
    # The scan at the end of a step is what the step gained.
    gains = np.array([steps.gain[a + 1 : b + 1].sum() for a, b in bounds])
    rates = gains / np.maximum(lengths, 1e-9)
    is_dry = rates < DRY
    driven = np.concatenate([[0.0], np.cumsum(steps.metres)])
    index = 0
    while index < len(bounds):
        last = index
        if not is_dry[index]:
            kind[slice(*bounds[index])] = KINDS.index("sliver" if rates[index] < THIN else "gain")
        else:
            while last + 1 < len(bounds) and is_dry[last + 1]:
                last += 1
            begin, end = bounds[index][0], bounds[last][1]
            name, length = "sliver", float(lengths[index : last + 1].sum())
            if length >= LEAST - 1e-9:
                name = "transit"
                before = int(np.searchsorted(driven, driven[begin] - AGO, side="right")) - 1
                if last + 1 < len(bounds) and before >= 0:
                    after = steps.gain[end + 1 : bounds[last + 1][1] + 1]
                    aside = 2.0 * detour(before, end + 1 + int((after > 0.0).argmax()))
                    if aside <= length:
                        name = "return"
                        price[end - 1] = length - aside
            kind[begin:end] = KINDS.index(name)
        index = last + 1
    return Split(kind, dithering, steps.metres, price)


def _pieces(metres: np.ndarray) -> list[tuple[int, int]]:
    """Return the first and the last step, exclusive, of pieces that are `PIECE` long or longer."""
    bounds, first, length = [], 0, 0.0
    for step, each in enumerate(metres.tolist()):
        length += each
        if length >= PIECE - 1e-9:
            bounds.append((first, step + 1))
            first, length = step + 1, 0.0
    if first < len(metres):
        bounds.append((first, len(metres)))
    return bounds


def slow_seconds(speeds: np.ndarray, period: float, highest: float) -> tuple[float, float]:
    """Return the time below `SLOW` times the greatest speed, and the time that slowness costs [s].

    The latter is how much longer the run takes than the same path at the greatest speed.

    Args:
        speeds: (N,) speeds of the steps [m/s].
        period: duration of a step [s].
        highest: the greatest speed [m/s].
    """
    below = float((speeds < SLOW * highest).sum() * period)
    lost = float((np.maximum(highest - speeds, 0.0) / highest).sum() * period)
    return below, lost


def driven_lengths(positions: np.ndarray) -> np.ndarray:
    """Return the lengths (N,) between positions (N + 1, 2) [m]."""
    moves = np.diff(np.asarray(positions, np.float64), axis=0)
    return np.hypot(moves[:, 0], moves[:, 1])


def scan_steps(num_steps: int, steps_per_scan: int) -> np.ndarray:
    """Return the instants of the scans: one at the beginning of each scan period, and the end."""
    instants = np.arange(0, num_steps, max(1, steps_per_scan))
    return np.append(instants, num_steps) if num_steps else np.zeros(1, np.int64)
