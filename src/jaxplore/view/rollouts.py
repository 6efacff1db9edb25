"""What colours the rollouts of a view: their weight, their total cost, or one term of it."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.report.drawing.colours import FREE, blend
from jaxplore.report.drawing.palette import FAINT, STRONG, Colour
from jaxplore.report.drawing.rollout_costs import (
    COST_COLOURS,
    NOT_FINITE,
    WEIGHT,
    cost_colours,
    cost_names,
    cost_range,
    costs_of_rollouts,
)
from jaxplore.report.drawing.shapes import STRONG_SHARE
from jaxplore.view.history import plain

if TYPE_CHECKING:
    import viser

FAINT_SHARE, BOLD_SHARE = 0.4, 0.95
"""Opacities of rollouts without weight and of those of great weight."""


class RolloutColours:
    """The choice of what colours the rollouts, and a legend with the range of the costs.

    `on_change` is called when a page has chosen something else.
    """

    def __init__(self, server: "viser.ViserServer", on_change: Callable[[], None]) -> None:
        gui = server.gui
        self._names = {WEIGHT: WEIGHT}
        self._choice: Any = gui.add_dropdown(
            "Colour rollouts by", (WEIGHT,), initial_value=WEIGHT, hint="darker: heavier or cheaper"
        )
        self._legend: Any = gui.add_html("")
        self._choice.on_update(lambda _: on_change())

    def offer(self, frame: Any) -> None:
        """Offer what a frame knows of its rollouts; a choice that is still offered stays."""
        names = {WEIGHT: WEIGHT}
        for name in cost_names(frame):
            label = plain(name)
            # Long names may begin alike.
            while label in names:
                label += "*"
            names[label] = name
        self._names = names
        if tuple(self._choice.options) != tuple(names):
            self._choice.options = tuple(names)
        has_rollouts = np.size(getattr(frame, "samples", ())) > 0
        self._choice.visible = self._legend.visible = has_rollouts

    def colours(self, frame: Any) -> np.ndarray:
        """Return the colours (S, 3) of the rollouts of a frame, and write their legend."""
        # A page could send anything.
        name = self._names.get(self._choice.value, WEIGHT)
        if name == WEIGHT or not cost_names(frame):
            known = len(self._names) > 1
            self._write("" if known else _note("This controller tells no costs of its rollouts."))
            return weight_colours(frame.weights)
        costs = costs_of_rollouts(frame, name)
        self._write(legend(costs))
        return cost_colours(costs)

    def _write(self, text: str) -> None:
        if self._legend.content != text:
            self._legend.content = text


def legend(costs: np.ndarray) -> str:
    """Return the legend of costs (S,) as HTML: the colours between the least and the greatest."""
    ends = cost_range(costs)
    if ends is None:
        return _note("No cost is finite.")
    low, high = (f"{each:.4g}" for each in ends)
    colours = ", ".join(map(_css, COST_COLOURS))
    bar = f"height:0.7em; border-radius:0.2em; background:linear-gradient(to right, {colours})"
    row = "display:flex; justify-content:space-between"
    rest = int(np.sum(~np.isfinite(costs)))
    more = _note(f"{rest} not finite", _css(NOT_FINITE)) if rest else ""
    return (
        f'<div style="padding:0 1em; font-size:0.85em"><div style="{bar}"></div>'
        f'<div style="{row}"><span>{low}</span><span>{high}</span></div></div>{more}'
    )


def _note(text: str, colour: str = "inherit") -> str:
    return f'<div style="padding:0 1em; font-size:0.85em; color:{colour}">{text}</div>'


def _css(colour: Colour) -> str:
    return f"rgb{tuple(colour[:3])}"


def weight_colours(weights: np.ndarray) -> np.ndarray:
    """Return the colours (S, 3) of rollouts by their weights (S,), of which NaN counts as 0.

    Below a share of the greatest weight they are faint. From there on the colour follows the
    weight, up to strong.
    """
    known = np.nan_to_num(weights)
    greatest = max(float(known.max(initial=0.0)), 1e-30)
    share = np.clip(known / greatest, 0.0, 1.0)
    # A weight at the bound between faint and bold lines of the animation is seen as well.
    level = np.where(share >= STRONG_SHARE, 0.4 + 0.6 * np.sqrt(share), 0.0)[:, None]
    faint, strong = (
        np.asarray(blend(each, FREE, opacity))
        for each, opacity in ((FAINT, FAINT_SHARE), (STRONG, BOLD_SHARE))
    )
    return np.asarray(((1.0 - level) * faint + level * strong).round(), np.uint8)
