"""The scale bar of a map figure."""

from typing import TYPE_CHECKING

from jaxplore.report.drawing.colours import OCCUPIED, shade
from jaxplore.report.drawing.picture import round_length

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LONGEST, BELOW = 0.25, 30.0
"""Greatest length of the bar as a share of the axis, and its distance below the axis [points]."""

FAR = 1e4
"""Coordinate from which matplotlib would label axes with an offset [m]."""


def add_scale_bar(axes: "Axes") -> None:
    """Draw a bar of a round length below the right end of axes in metres, beside their label.

    The limits of the axes must be set. Far from the origin the labels of the axes are whole
    coordinates, without a common offset.
    """
    from matplotlib.transforms import ScaledTranslation, blended_transform_factory

    if max(map(abs, (*axes.get_xlim(), *axes.get_ylim()))) >= FAR:
        axes.ticklabel_format(useOffset=False, style="plain")
        axes.locator_params(axis="x", nbins=4)
    left, right = axes.get_xlim()
    length = round_length(LONGEST * (right - left))
    figure = axes.get_figure(root=True)
    assert figure is not None
    down = ScaledTranslation(0.0, -BELOW / 72.0, figure.dpi_scale_trans)
    place = blended_transform_factory(axes.transData, axes.transAxes) + down
    ink = shade(OCCUPIED)
    axes.plot(
        [right - length, right],
        [0.0, 0.0],
        transform=place,
        color=ink,
        linewidth=2.0,
        marker="|",
        markersize=7.0,
        clip_on=False,
    )
    axes.text(
        right - 0.5 * length,
        0.0,
        f"{length:g} m\n",
        transform=place,
        color=ink,
        fontsize=8,
        ha="center",
        va="center",
        linespacing=1.6,
    )
