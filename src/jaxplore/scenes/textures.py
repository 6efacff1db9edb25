"""The picture that lies on the ground of the view: belief and information."""

import numpy as np
from PIL import Image

from jaxplore.report.drawing.colours import belief_colours
from jaxplore.report.drawing.palette import HEAT, MAX_HEAT
from jaxplore.report.drawing.picture import to_frame

SHARP_SIDE = 600
"""Longest side up to which cells are repeated, so that they stay sharp [pixels]."""
LARGEST_SIDE = 1600
"""Longest side above which cells are left out [pixels]."""
KNOWN_FREE = 64
"""Level of a probability, of 255, below which a cell can be entered to gain information."""
BRIGHTEST = 99.0
"""Percentile of the information at which its colour saturates. A view does not know the brightest
field of a run that goes on."""


class Ground:
    """Draws the ground: the belief, and over it the information of scans.

    Args:
        shape: numbers of rows and columns of the map.
        origin: pose of the map [m, m, rad].
        resolution: side of a cell [m].
        field_origin: pose of the lattice of the information field [m, m, rad].
        spacing: distance between its nodes [m].
    """

    def __init__(
        self,
        shape: tuple[int, int],
        origin: np.ndarray,
        resolution: float,
        field_origin: np.ndarray,
        spacing: float,
    ) -> None:
        self._step = -(-max(shape) // LARGEST_SIDE)
        rows, columns = (-(-side // self._step) for side in shape)
        self._size = columns, rows
        self._times = max(1, SHARP_SIDE // max(rows, columns))
        # Where three cells lie in the field tells where all do.
        corners = self._step * resolution * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        yaw = float(origin[2])
        turned = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        world = corners @ turned + np.asarray(origin[:2], np.float64)
        zero, right, up = to_frame(world, field_origin) / spacing
        across, down = right - zero, up - zero
        self._map = (across[0], down[0], zero[0], across[1], down[1], zero[1])
        self._colours = _sixteen_levels()

    def picture(self, probability: np.ndarray, information: np.ndarray | None = None) -> np.ndarray:
        """Return the ground (rows, columns, 3).

        Row 0 is that of the grid, which viser draws at the low end of y.

        Args:
            probability: (H, W) belief in 256 levels.
            information: (R, C) information of a scan at the nodes of the field [nat]; None to leave
                it out.
        """
        level = probability[:: self._step, :: self._step]
        colours = self._colours[level]
        if information is not None:
            is_free = level < KNOWN_FREE
            share = self._share(information, is_free)[is_free, None]
            heat = np.asarray(HEAT, np.float32)
            colours[is_free] += MAX_HEAT * share * (heat - colours[is_free])
        drawn = np.round(colours).astype(np.uint8)
        columns, rows = self._size
        larger = (columns * self._times, rows * self._times)
        # Pillow repeats cells three times as fast as NumPy.
        return np.asarray(Image.fromarray(drawn).resize(larger, Image.Resampling.NEAREST))

    def _share(self, information: np.ndarray, is_free: np.ndarray) -> np.ndarray:
        """Return the information at the cells as a share of the brightest."""
        nodes = Image.fromarray(np.nan_to_num(information).astype(np.float32))
        gain = np.asarray(
            nodes.transform(
                self._size, Image.Transform.AFFINE, self._map, Image.Resampling.BILINEAR
            )
        )
        brightest = float(np.percentile(gain[is_free], BRIGHTEST)) if is_free.any() else 0.0
        return np.asarray(np.clip(gain / max(brightest, 1e-6), 0.0, 1.0))


def _sixteen_levels() -> np.ndarray:
    """Return the colours (256, 3) of a belief, in steps that make a small picture."""
    level = np.arange(256)
    rounded = np.where(level >= 240, 255, level // 16 * 16)
    rounded[np.abs(level - 128) < 8] = 128
    return belief_colours()[rounded].astype(np.float32)
