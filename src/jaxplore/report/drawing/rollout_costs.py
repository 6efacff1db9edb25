"""Colours of rollouts by what they cost: in total, or of one term."""

from typing import Any

import numpy as np

from jaxplore.report.drawing.palette import PALE

WEIGHT, TOTAL = "weight", "total cost"
"""Names of what colours rollouts beside the terms of the cost."""
COST_COLOURS = (
    (68, 1, 84),
    (72, 32, 113),
    (67, 61, 132),
    (57, 86, 140),
    (46, 110, 142),
    (38, 130, 142),
    (31, 152, 139),
    (39, 173, 129),
    (74, 193, 109),
    (122, 209, 81),
)
"""Colours from the cheapest rollout, dark as the heaviest ones are, to the dearest: the map viridis
(van der Walt and Smith, 2015), which gets lighter all the way with each kind of colour blindness.
It ends at 80 %, beyond which it hardly differs from the ground."""
NOT_FINITE = PALE
"""Colour of a cost that is infinite or NaN."""


def cost_names(frame: Any) -> tuple[str, ...]:
    """Return by which costs the rollouts of a frame can be coloured: the total, and each term.

    There are none if the frame has no costs of rollouts. A term that is called as the total or the
    weight is left out.
    """
    terms = tuple(getattr(frame, "sample_terms", ()))
    others = [name for name in terms if name not in (WEIGHT, TOTAL)]
    return (TOTAL, *others) if terms else ()


def costs_of_rollouts(frame: Any, name: str) -> np.ndarray:
    """Return what the rollouts of a frame cost (S,), in double precision.

    The name is that of a term, or `TOTAL` for the sum of all terms. A cost that the frame does not
    have raises a `ValueError`.
    """
    known = cost_names(frame)
    if name not in known:
        told = ", ".join((WEIGHT, *known)) if known else f"{WEIGHT}; nobody knows the costs"
        raise ValueError(f"the colour of rollouts is {name!r}; accepted: {told}")
    chosen = frame.sample_terms.values() if name == TOTAL else (frame.sample_terms[name],)
    # An infinite term and one of the other sign add up to NaN, which has a colour of its own.
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sum([np.asarray(each, np.float64) for each in chosen], axis=0))


def cost_range(costs: np.ndarray) -> tuple[float, float] | None:
    """Return the least and the greatest finite cost; None if no cost is finite."""
    known = costs[np.isfinite(costs)]
    return (float(known.min()), float(known.max())) if known.size else None


def cost_colours(costs: np.ndarray) -> np.ndarray:
    """Return the colours (S, 3) of costs (S,) from least to greatest; one not finite is grey."""
    colours = np.broadcast_to(np.asarray(NOT_FINITE, np.float64), (len(costs), 3)).copy()
    ends = cost_range(costs)
    if ends is not None:
        low, high = ends
        is_known = np.isfinite(costs)
        share = (costs[is_known] - low) / max(high - low, np.finfo(np.float64).tiny)
        nodes = np.linspace(0.0, 1.0, len(COST_COLOURS))
        channels = np.array(COST_COLOURS, np.float64).T
        colours[is_known] = np.stack([np.interp(share, nodes, each) for each in channels], axis=-1)
    return np.asarray(colours.round(), np.uint8)
