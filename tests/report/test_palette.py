"""Colours that must be told apart, seen with each kind of colour blindness."""

import itertools

import matplotlib
import numpy as np
import pytest

from jaxplore.report.drawing import colours, palette
from jaxplore.report.drawing.colours import blend
from jaxplore.report.drawing.rollout_costs import cost_colours
from jaxplore.report.drawing.series import line_style

LEAST = 20.0
"""Least CIE 1976 difference; 2.3 is just noticeable side by side, and thin lines need much more."""

# Matrices for linear RGB at severity 1 from Machado, Oliveira, Fernandes, "A physiologically-based
# model for simulation of color vision deficiency", IEEE TVCG 15 (6), 2009, supplement.
VISION = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "tritanopia": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ]
    ),
}


def rgb(colour) -> np.ndarray:
    if isinstance(colour, str):
        colour = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return np.asarray(colour[:3], float) / 255.0


def lab(colour, vision) -> np.ndarray:
    """CIE L*a*b* (D65) of an sRGB colour, seen with a kind of vision."""
    encoded = rgb(colour)
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    seen = np.clip(VISION[vision] @ linear, 0.0, 1.0)
    to_xyz = np.array(
        [
            [0.4124564, 0.3575761, 0.1804375],
            [0.2126729, 0.7151522, 0.0721750],
            [0.0193339, 0.1191920, 0.9503041],
        ]
    )
    t = to_xyz @ seen / np.array([0.95047, 1.0, 1.08883])
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def difference(one, other, vision) -> float:
    return float(np.linalg.norm(lab(one, vision) - lab(other, vision)))


def test_the_simulation_agrees_with_what_is_known():
    # White and black stay, and are 100 apart.
    for vision in VISION:
        assert difference((255, 255, 255), (0, 0, 0), vision) == pytest.approx(100.0, abs=0.2)
    # L*a*b* of sRGB red, from any table.
    np.testing.assert_allclose(lab((255, 0, 0), "normal"), [53.24, 80.09, 67.20], atol=0.05)
    # A red and a green that are far apart, and hardly differ for a deuteranope.
    red, green = (214, 40, 85), (64, 145, 62)
    assert difference(red, green, "normal") > 100.0
    assert difference(red, green, "deuteranopia") < 10.0


HEAT = blend(palette.HEAT, colours.FREE, palette.MAX_HEAT)
CLOSED = blend(colours.CLOSED, colours.FREE, colours.CLOSED_SHARE)
GROUPS = {
    "curves of a figure": [*colours.SERIES, palette.PAPER],
    "lines of a film": [
        *(palette.TRAIL, palette.STRONG, palette.PLAN, palette.REFERENCE, palette.LIDAR_RAY),
        *(colours.FREE, colours.UNKNOWN),
    ],
    "lines over information": [palette.TRAIL, palette.STRONG, palette.PLAN, HEAT],
    "ground": [colours.FREE, colours.UNKNOWN, palette.HIDDEN_WALL, colours.OCCUPIED],
    "information": [colours.FREE, colours.UNKNOWN, HEAT, colours.OCCUPIED],
    "closed ground": [colours.FREE, colours.UNKNOWN, CLOSED, colours.OCCUPIED],
    "map figure": [
        colours.FREE,
        colours.UNKNOWN,
        colours.OCCUPIED,
        colours.MISSED,
        colours.OUTLINE,
    ],
    "course": [colours.FREE, palette.TRAIL, palette.PLAN, palette.INK, palette.PALE],
    "violation": [colours.FREE, palette.TRAIL, colours.MISSED, palette.INK],
    "mover": [colours.FREE, colours.UNKNOWN, colours.MOVER_EDGE, colours.MOVER],
    # Thirds of the range: what lies between is told by the order of lightness.
    "rollouts by cost": [
        *map(tuple, cost_colours(np.arange(4.0)).tolist()),
        colours.FREE,
        colours.UNKNOWN,
    ],
    "target": [colours.FREE, colours.UNKNOWN, HEAT, colours.TARGET],
}


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("name", GROUPS)
def test_colours_of_a_picture_are_told_apart(name, vision):
    close = {
        (one, other): round(difference(one, other, vision), 1)
        for one, other in itertools.combinations(GROUPS[name], 2)
        if difference(one, other, vision) < LEAST
    }
    assert not close


def test_many_curves_differ_in_line_style_where_colours_repeat():
    styles = [tuple(line_style(number).items()) for number in range(4 * len(colours.SERIES))]
    assert len(set(styles)) == len(styles)


@pytest.mark.parametrize("vision", VISION)
def test_a_cheaper_rollout_is_darker(vision):
    shown = cost_colours(np.linspace(-3.0, 5.0, 41))
    lightness = [lab(each, vision)[0] for each in shown]
    assert (np.diff(lightness) > 0.1).all()


def test_colours_of_costs_are_those_of_viridis_between_the_finite_ones():
    costs = np.random.default_rng(0).normal(size=200) * 1e30
    expected = matplotlib.colormaps["viridis"](0.8 * (costs - costs.min()) / np.ptp(costs))
    odd = np.array([np.nan, np.inf, -np.inf])
    shown = cost_colours(np.concatenate([costs, odd]))
    np.testing.assert_allclose(shown[:-3], 255.0 * expected[:, :3], atol=6.0)
    assert {tuple(each) for each in shown[-3:].tolist()} == {palette.PALE}
    assert cost_colours(odd).tolist() == [list(palette.PALE)] * 3
    assert len(np.unique(cost_colours(np.full(5, 2.0)), axis=0)) == 1
    assert cost_colours(np.zeros(0)).shape == (0, 3)
