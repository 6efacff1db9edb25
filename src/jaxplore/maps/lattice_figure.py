"""Draw values on a lattice, in metres."""

import functools
import io
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from jaxplore._types import ArrayLike
from jaxplore.maps.frame import GridFrame

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LONGEST = 6.0
"""Longer side of the lattice in a figure [inches]."""


def lattice_figure(
    values: ArrayLike,
    frame: GridFrame,
    label: str,
    *,
    colours: str = "viridis",
    limits: tuple[float, float] | None = None,
) -> "Figure":
    """Draw values (H, W) at their place in the world, with a colour bar that ends at `limits`, by
    default those of the data. Values that are not finite and the padding are left out."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.transforms import Affine2D

    cells = np.ma.masked_invalid(frame.crop(values))
    rows, columns = cells.shape
    ends = [[0.0, 0.0], [0.0, columns], [rows, 0.0], [rows, columns]]
    corners = np.asarray(frame.to_world(jnp.asarray(ends)))
    low, high = corners.min(axis=0), corners.max(axis=0)
    width, height = LONGEST * (high - low) / (high - low).max()
    figure = Figure(figsize=(max(width, 2.0) + 1.6, max(height, 2.0) + 0.7), layout="compressed")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    x, y, yaw = (float(each) for each in np.asarray(frame.origin))
    image = axes.imshow(
        cells,
        extent=(0.0, columns * frame.resolution, 0.0, rows * frame.resolution),
        origin="lower",
        interpolation="nearest",
        cmap=colours,
        vmin=None if limits is None else limits[0],
        vmax=None if limits is None else limits[1],
        transform=Affine2D().rotate(yaw).translate(x, y) + axes.transData,
    )
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    figure.colorbar(image, ax=axes, label=label)
    return show_in_notebooks(figure)


def show_in_notebooks(figure: "Figure") -> "Figure":
    """Return the figure, which a notebook then shows at the end of a cell.

    By itself a figure that was made without `pyplot` is shown as text.
    """
    # Notebooks look for a method of this name, and find it on an instance as well.
    setattr(figure, "_repr_png_", functools.partial(_png, figure))  # noqa: B010
    return figure


def _png(figure: "Figure") -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()
