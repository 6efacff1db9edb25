"""The motions of a car: the cells that they pass, against a walk along them."""

import math

import numpy as np
import pytest

from jaxplore.geometry.state_lattice import HEADINGS, SAMPLING, Motion, motions


def walked(motion: Motion, radius: float) -> np.ndarray:
    """Return the cells (N, 2) of a motion, by small steps of a car's equations."""
    steps = 1000
    speed = motion.length / steps
    at = (np.arange(steps) + 0.5) * speed
    turned = np.clip(at - motion.before, 0.0, radius * abs(motion.turn)) / radius
    middle = HEADINGS[motion.start] + math.copysign(1.0, motion.turn) * turned
    place = np.cumsum(speed * np.stack([np.sin(middle), np.cos(middle)], axis=-1), axis=0)
    np.testing.assert_allclose(place[-1], (motion.down, motion.right), atol=1e-2)
    return np.round(place).astype(int)


@pytest.mark.parametrize("radius", [0.25, 3.75, 6.0])
def test_a_motion_checks_the_cells_that_it_passes(radius: float) -> None:
    for motion in motions(radius):
        checked = {(0, 0), (motion.down, motion.right)}
        checked |= {(each.down, each.right) for each in motion.via}
        cells, steps = np.unique(walked(motion, radius), axis=0, return_counts=True)
        # A cell whose corner is cut between two samples of the motion is left out.
        is_long = steps * motion.length / steps.sum() > SAMPLING
        assert {tuple(cell) for cell in cells[is_long].tolist()} <= checked
