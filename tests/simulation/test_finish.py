"""What an exploration ends by: the judge's coverage, or what the robot can still learn."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.belief.belief import Belief
from jaxplore.belief.exploration_field import GOAL_DETOUR, LEFTOVER_DETOUR
from jaxplore.belief.guidance import GuidanceField
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.exploration.data import MapProgress
from jaxplore.robot.robot import Knowledge
from jaxplore.simulation.exploration.finish import (
    TARGETS,
    choose_target,
    is_finished,
)

NOTHING, HALF = jnp.zeros(()), jnp.asarray(0.5)
after = eqx.filter_jit(lambda known, belief: known.update(belief, jnp.ones(2), HALF))
counted = eqx.filter_jit(lambda grid: Knowledge.nothing().count_walls(grid))


def knowing(cost: float) -> Belief:
    """Return a belief whose cost-to-go is one number."""
    values = jnp.full((4, 4), cost)
    return Belief(
        guidance=GuidanceField(values, jnp.zeros((2, 4, 4)), GridFrame(1.0), NOTHING + 1e4)
    )


@pytest.mark.parametrize(
    ("cost", "idle"),
    [
        (-20.0, 0.0),  # a place with information
        (300.0, 0.0),  # one far away
        (GOAL_DETOUR + 3.0, 2.5),
        (LEFTOVER_DETOUR + 5.0, 2.5),
        (1e4, 2.5),
    ],
)
def test_a_robot_has_time_where_no_place_is_worth_a_visit(cost, idle) -> None:
    known = Knowledge(NOTHING + 2.0, NOTHING)
    assert float(after(known, knowing(cost)).idle) == idle


@pytest.mark.parametrize("seed", range(3))
def test_walls_are_counted_cell_by_cell(seed: int) -> None:
    cells = np.random.default_rng(seed).choice([0.01, 0.5, 0.99, 0.3], (12, 15)).astype(np.float32)
    walls = unknown = 0
    for row, column in np.ndindex(cells.shape):
        beside = [
            cells[row + down, column + right]
            for down, right in ((1, 0), (-1, 0), (0, 1), (0, -1))
            if 0 <= row + down < 12 and 0 <= column + right < 15
        ]
        if min(beside) < 0.1:
            walls += cells[row, column] > 0.9
            unknown += 4.0 * cells[row, column] * (1.0 - cells[row, column]) > 0.5
    grid = OccupancyGrid(cells, 0.1)
    open_cells = np.asarray(grid.is_free)
    assert (open_cells == (cells < 0.1)).all()
    assert float(counted(grid).walls) == pytest.approx(walls / (walls + unknown), rel=1e-6)


def ends(target: str, coverage: float, idle: float, walls: float) -> bool:
    progress = MapProgress(NOTHING + coverage, *(NOTHING for _ in range(3)))
    known = Knowledge(NOTHING + idle, NOTHING + walls)
    nobody, least = None, NOTHING + 0.9
    end = (jnp.asarray(TARGETS.index(target)), least, known, None, NOTHING)
    return bool(is_finished(progress, nobody, *end, counts_walls=target == "walls"))


def test_each_target_has_an_end_of_its_own() -> None:
    assert ends("coverage", 0.91, 0.0, 0.0)
    assert not ends("coverage", 0.89, 9.0, 1.0)
    # The true map does not end what the robot decides.
    assert not ends("information", 1.0, 2.9, 1.0)
    assert ends("information", 0.5, 3.1, 0.0)
    assert not ends("walls", 1.0, 2.9, 0.89)
    assert ends("walls", 0.5, 0.0, 0.91)
    # Little information may be a piece of wall: it goes on for `give_up_after`.
    assert not ends("walls", 0.5, 3.1, 0.0)
    assert not ends("never", 1.0, 9.0, 1.0)


def test_the_target_follows_from_what_is_given() -> None:
    def chosen(target=None, *, has_coverage=True, is_patrol=False):
        return choose_target(target, has_coverage=has_coverage, is_patrol=is_patrol)

    assert chosen() == chosen(is_patrol=True) == "coverage"
    assert chosen(has_coverage=False) == "information"
    assert chosen(has_coverage=False, is_patrol=True) == "never"
    assert chosen("walls") == "walls"
    with pytest.raises(
        ValueError, match="target is 'time'; accepted: coverage, information, walls, n"
    ):
        chosen("time")
    with pytest.raises(ValueError, match="target is 'walls' without a target_coverage"):
        chosen("walls", has_coverage=False)
