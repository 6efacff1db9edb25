"""What a rule of one's own is given, and what is said of its mistakes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.belief.roadmap import Roadmap
from jaxplore.belief.volume_roads import VolumeRoads
from jaxplore.maps.frame import GridFrame
from jaxplore.planning import TargetRule
from jaxplore.planning.strategy.frontiers import Frontiers
from jaxplore.planning.strategy.target_rules import ask

ONES, MASK = jnp.ones((3, 4)), jnp.ones((3, 4), bool)
KEY = jax.random.key(0)


def frontiers(roads, shape):
    ones, mask = jnp.ones(shape), jnp.ones(shape, bool)
    return Frontiers(roads, ones, ones, mask, mask, mask, mask)


FLAT = frontiers(Roadmap(GridFrame(0.5, (1.0, -2.0, 0.5)), ONES, MASK, None), ONES.shape)


def test_positions_are_those_of_the_nodes_in_the_plane() -> None:
    found = np.asarray(FLAT.positions)
    assert found.shape == (3, 4, 2)
    # By a rotation and a shift of the centres of the cells.
    rows, columns = np.indices(ONES.shape)
    turn = np.exp(0.5j)
    expected = (1.0 - 2.0j) + turn * 0.5 * ((columns + 0.5) + 1j * (rows + 0.5))
    np.testing.assert_allclose(found[..., 0] + 1j * found[..., 1], expected, atol=1e-5)


def test_positions_in_a_volume_have_a_height() -> None:
    shape = (2, 3, 4)
    half = jnp.ones([2 * side - 1 for side in shape], bool)
    origin = jnp.array([1.0, 2.0, 3.0])
    roads = VolumeRoads(half, jnp.ones(shape), origin, 0.5)
    found = np.asarray(frontiers(roads, shape).positions)
    assert found.shape == (*shape, 3)
    np.testing.assert_allclose(found[1, 2, 3], [2.5, 3.0, 3.5])


class Own(TargetRule):
    """A rule whose methods are functions."""

    candidates_by: object
    scores_by: object

    def candidates(self, frontiers):
        return self.candidates_by(frontiers)

    def scores(self, frontiers, *, key):
        return self.scores_by(frontiers)


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (lambda f: f.is_views, "rule Own fails in {}: AttributeError: 'Frontiers' object has no"),
        (lambda f: f.worth @ f.worth, "rule Own fails in {}: TypeError: dot_general requires"),
        (lambda f: 1 / 0, "rule Own fails in {}: ZeroDivisionError: division by zero"),
        (lambda f: None, "{} of rule Own are None; accepted: .* of shape \\(3, 4\\), such as"),
        (lambda f: f.is_view.sum(), "{} of rule Own are an array of shape \\(\\); accepted: "),
        (lambda f: f.positions, "{} of rule Own are an array of shape \\(3, 4, 2\\); accepted: "),
    ],
)
@pytest.mark.parametrize("method", ["candidates", "scores"])
def test_a_mistake_in_a_rule_is_one_line(method, function, said) -> None:
    options = {"key": KEY} if method == "scores" else {}
    with pytest.raises(ValueError, match=said.format(method)) as error:
        ask(Own(function, function), method, FLAT, **options)
    assert "\n" not in str(error.value)


def test_a_rule_without_mistakes_is_asked() -> None:
    rule = Own(lambda f: f.positions[..., 0] > 1.0, lambda f: f.worth / f.distance)
    assert ask(rule, "candidates", FLAT).shape == (3, 4)
    np.testing.assert_array_equal(ask(rule, "scores", FLAT, key=KEY), ONES)
    with pytest.raises(ValueError, match=r"candidates of rule Own are .*; accepted: a mask"):
        ask(Own(lambda f: f.worth, None), "candidates", FLAT)
