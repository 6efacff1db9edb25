"""Which readings of a lidar met nothing: drivers report that in different ways."""

from typing import Literal, get_args

import numpy as np

NoEchoRule = Literal["auto", "inf", "max", "zero"]
"""How a driver reports a beam that met nothing, see `NoEcho`."""
SCANS = 20
"""Number of scans after which it is known what a lidar never reports."""
RARE_SHARE, ROUNDING = 0.01, 1e-3
"""Share of the readings of a scan that walls have of the very greatest range, and how far below it
that is, as a share of it."""
LEAST_SHARE = 0.1
"""Share of the readings of these scans that are 0 or NaN, from which on they met nothing."""


class NoEcho:
    """Tells which readings met nothing, by the convention of a driver.

    | rule | readings that met nothing |
    | --- | --- |
    | `inf` | infinite ones (REP 117) |
    | `max` | also those that reach the greatest range, less the margin |
    | `zero` | also 0 and NaN |
    | `auto` | those of `max`; those of `zero` once it is known that the lidar needs it |

    A lidar needs `zero` if in 20 scans no reading was infinite or the greatest one, and a tenth
    were 0 or NaN.

    A reading of 0 may also be too near, or of glass: only where a lidar reports nothing else for
    open space is it taken for that.

    The margin is a distance [m], such as the side of a cell of the map. `news` tells what was found
    from the readings since it was read last; empty without any.
    """

    def __init__(self, rule: str = "auto", margin: float = 0.0) -> None:
        if rule not in get_args(NoEchoRule):
            raise ValueError(f"no_echo is {rule!r}; accepted: {', '.join(get_args(NoEchoRule))}")
        self._rule, self._margin = rule, margin
        self.news = ""
        self._has_zeros, self._has_greatest = rule == "zero", False
        self._scans, self._readings, self._nothing, self._is_other = 0, 0, 0, False

    def with_infinite(self, ranges: np.ndarray, range_max: float) -> np.ndarray:
        """Return readings (R,) [m] in which those that met nothing are infinite.

        `range_max` is the greatest valid reading [m], infinite if there is none.
        """
        if self._rule == "inf":
            return ranges
        is_greatest = ranges >= range_max - self._margin
        is_nothing = ~(ranges > 0.0)
        if self._rule == "auto":
            self._look(ranges, range_max, is_nothing)
        met_nothing = is_greatest | is_nothing if self._has_zeros else is_greatest
        return np.where(met_nothing, np.inf, ranges)

    def _look(self, ranges: np.ndarray, range_max: float, is_nothing: np.ndarray) -> None:
        """Find out what the driver reports for a beam that met nothing."""
        # Walls have readings near the greatest one as well, but few of the very greatest.
        is_very_greatest = np.isfinite(ranges) & (ranges >= (1.0 - ROUNDING) * range_max)
        is_reported = is_very_greatest.mean() >= RARE_SHARE
        if is_reported and not self._has_greatest:
            self._has_greatest = True
            self.news = (
                "the lidar reports its greatest range where a beam meets nothing; "
                "node.no_echo: inf takes such readings for walls"
            )
        if self._scans == SCANS:
            return
        self._scans += 1
        self._readings += ranges.size
        self._nothing += int(is_nothing.sum())
        self._is_other |= bool(is_reported or (ranges == np.inf).any())
        share = self._nothing / self._readings
        if self._scans == SCANS and not self._is_other and share >= LEAST_SHARE:
            self._has_zeros = True
            self.news = (
                f"the lidar reports 0 or NaN for {100.0 * share:.0f} % of its readings, and never "
                "an infinite or its greatest range: such beams count as free; node.no_echo: inf "
                "takes them for no measurement"
            )
