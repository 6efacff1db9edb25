"""Ways of Reeds and Shepp, against the poses that they lead to and against random ways."""

import numpy as np
import pytest

from jaxplore.geometry.reeds_shepp import _words, lengths

PIECES = ["LSL", "LRL", "LRL", "LRSL", "LSR", "LRLR", "LRLR", "LRSR", "LRSLR"]


def drive(pieces, arcs):
    """Return the pose at the end of a way on circles of radius 1; arcs are negative backwards."""
    x, y, yaw = 0.0, 0.0, 0.0
    for piece, arc in zip(pieces, arcs, strict=True):
        side = {"L": 1.0, "R": -1.0, "S": 0.0}[piece]
        after = yaw + side * arc
        straight = arc * (side == 0.0)
        x = x + straight * np.cos(yaw) + side * (np.sin(after) - np.sin(yaw))
        y = y + straight * np.sin(yaw) - side * (np.cos(after) - np.cos(yaw))
        yaw = after
    return x, y, yaw


def test_each_way_leads_to_its_pose() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-4.0, 4.0, (2, 500))
    turn = rng.uniform(-np.pi, np.pi, 500)
    for pieces, (gears, arcs) in zip(PIECES, _words(x, y, turn), strict=True):
        driven = [
            gear * np.broadcast_to(arc, x.shape) for gear, arc in zip(gears, arcs, strict=True)
        ]
        there = np.isfinite(np.sum(driven, axis=0))
        assert there.sum() > 20
        at_x, at_y, yaw = (each[there] for each in drive(pieces, driven))
        assert np.hypot(at_x - x[there], at_y - y[there]).max() < 1e-6
        assert np.abs(np.exp(1j * yaw) - np.exp(1j * turn[there])).max() < 1e-6
        assert min(each[there].min() for each in np.abs(driven)) >= 0.0


def test_no_random_way_is_shorter() -> None:
    rng = np.random.default_rng(1)
    arcs = rng.uniform(-1.5, 1.5, (5, 400))
    # A piece in three has no length, so that there are short ways as well.
    arcs *= rng.random(arcs.shape) < 0.67
    for _ in range(40):
        pieces = rng.choice(list("LRS"), 5)
        found = lengths(*drive(pieces, arcs), 0.0)
        assert (found <= np.abs(arcs).sum(axis=0) + 1e-9).all()


@pytest.mark.parametrize(
    ("pose", "forwards", "backwards"),
    [
        ((3.0, 0.0, 0.0), 3.0, 3.0 + 0.5),
        ((-2.0, 0.0, 0.0), 2.0 + 0.5, 2.0),
        ((1.0, 1.0, 0.5 * np.pi), 0.5 * np.pi, 0.5 * np.pi + 0.5),
        # To turn around on the spot a car drives a sixth of a circle three times.
        ((0.0, 0.0, np.pi), np.pi + 2 * 0.5, np.pi + 2 * 0.5),
    ],
)
def test_the_costs_of_some_ways_are_known(pose, forwards: float, backwards: float) -> None:
    found = lengths(*np.array(pose)[:, None], 0.5)[:, 0]
    assert found == pytest.approx([forwards, backwards], abs=1e-9)
