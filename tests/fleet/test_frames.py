"""Robots that do not know where the others began: groups, links, and maps that are not certain."""

import dataclasses
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from tests.kinds import STARTS

from jaxplore.maps import OccupancyGrid
from jaxplore.report.exploration.team import TeamMetrics
from jaxplore.simulation.fleet.frames import Frames, find_frames
from jaxplore.simulation.fleet.radio import Radio
from jaxplore.simulation.fleet.state import FleetState, Team
from jaxplore.simulation.state import Moment

pytestmark = pytest.mark.long

ALL = np.ones((3, 3), bool)


def hall() -> np.ndarray:
    """Draw a hall of 24 m x 9 m with walls and boxes that do not repeat."""
    world = np.full((90, 240), 0.02)
    world[[0, 1, -2, -1]] = world[:, [0, 1, -2, -1]] = 0.98
    for rows, columns in (
        ((0, 50), (40, 42)),
        ((60, 90), (75, 77)),
        ((30, 32), (75, 120)),
        ((10, 18), (55, 66)),
        ((70, 80), (20, 30)),
        ((50, 62), (130, 137)),
        ((12, 20), (140, 146)),
        ((66, 70), (100, 118)),
        ((0, 40), (170, 172)),
        ((55, 58), (160, 200)),
        ((70, 78), (210, 222)),
    ):
        world[slice(*rows), slice(*columns)] = 0.98
    return world


def seen(first: int, last: int) -> OccupancyGrid:
    known = np.full((90, 240), 0.5)
    known[:, first:last] = hall()[:, first:last]
    return OccupancyGrid(known, 0.1, (-3.0, 2.0, 0.0))


MAPS = [seen(0, 110), seen(55, 180), seen(125, 240)]


def test_who_finds_one_of_a_group_knows_all_of_it() -> None:
    before = Frames.nothing(3)
    assert np.array_equal(before.known, np.eye(3, dtype=bool))
    chain = np.array([[False, True, False], [True, False, False], [False, False, False]])
    first = find_frames(before, MAPS, chain, np.array([2, 0, 1]), 5.0)
    assert np.array_equal(first.known, chain | np.eye(3, dtype=bool))
    link = np.zeros((3, 3), bool)
    link[1, 2] = link[2, 1] = True
    second = find_frames(first, MAPS, link, np.array([2, 0, 1]), 10.0)
    assert np.asarray(second.known).all()
    np.testing.assert_array_equal(
        second.found_at, [[0.0, 5.0, 10.0], [5.0, 0.0, 10.0], [10.0, 10.0, 0.0]]
    )
    assert 0.0 < float(np.max(second.errors)) < 0.1


def test_without_a_link_or_without_certainty_nothing_is_found() -> None:
    before = Frames.nothing(2)
    for maps, links in ((MAPS[:2], ~ALL), ([MAPS[0], MAPS[2]], ALL), ([seen(0, 1)] * 2, ALL)):
        after = find_frames(before, maps, links[:2, :2], np.arange(2), 5.0)
        for one, other in zip(before, after, strict=True):
            np.testing.assert_array_equal(one, other)


def test_a_fleet_searches_within_the_radio_range_until_all_is_known(fleet) -> None:
    starts = [(1.0, 1.0, 0.3), (1.0, 2.0, -0.4)]
    assert fleet(starts)[1].steps_per_revision is None
    _, near = fleet(starts, Radio(2.0), is_start_known=False)
    _, far = fleet(starts, Radio(0.5), is_start_known=False)
    assert near.steps_per_revision == 100  # 5 s at 20 Hz
    members = tuple(SimpleNamespace(belief=SimpleNamespace(grid=each)) for each in MAPS[:2])
    state = FleetState(near.start, members, *[None] * 3, team_of(Frames.nothing(2)), {})
    assert not np.asarray(far._with_frames(state, 200).team.frames.known).all()
    found = near._with_frames(state, 200)
    assert np.asarray(found.team.frames.known).all()
    assert float(found.team.frames.found_at[0, 1]) == pytest.approx(10.0)
    assert near._with_frames(found, 300) is found
    with pytest.raises(ValueError, match="is_start_known is False; accepted in several processes"):
        near.with_share(near.share)


def team_of(frames: Frames | None) -> Team:
    return Team(None, (), *[None] * 5, frames)


def test_robots_understand_each_other_when_they_know_their_frames(fleet, paired) -> None:
    """The same robots at the same places, by what they know of their frames alone."""
    _, known = fleet(STARTS[:2], Radio(10.0, uses_sight=False))
    state, _ = paired(10.0)
    task, off = state.task, jnp.array(False)
    moment = Moment(state.step, jnp.zeros(()), task.robot, off, off)
    links = eqx.filter_jit(lambda talk, task: talk.links(task, moment))
    none = Frames.nothing(2)
    both = Frames(jnp.ones((2, 2), bool), *none[1:])
    for frames, expected in ((None, True), (none, False), (both, True)):
        given = task._replace(team=task.team._replace(frames=frames))
        assert bool(links(known._talk, given)[0, 1]) is expected


def test_metrics_have_the_times_and_the_errors_of_merges() -> None:
    metrics = TeamMetrics(
        num_robots=3,
        coordination="claims",
        contacts=0,
        exchanged=0.0,
        linked=0.5,
        least_coverage=None,
        path_lengths=(1.0, 2.0, 3.0),
        frames_found_at=(12.0, 31.0),
        frame_errors=(0.04, 0.02),
    )
    said = dict(metrics.rows())["frames found"]
    assert said == "2 of 3 pairs, the last at 31 s, off by at most 0.040 m"
    known = dataclasses.replace(metrics, frames_found_at=None, frame_errors=None)
    assert "frames found" not in dict(known.rows())


def test_until_then_robots_drive_as_those_out_of_range(fleet, paired, run) -> None:
    """Side by side with a radio, against the same robots that hear nobody, to the bit."""
    controller, scenario = fleet(STARTS[:2], Radio(10.0, uses_sight=False), is_start_known=False)
    state, records = run(controller, scenario, 100)
    apart, alone = paired(0.1)
    np.testing.assert_array_equal(records.state, alone.state)
    for here, there in zip(state.task.members, apart.task.members, strict=True):
        np.testing.assert_array_equal(here.belief.grid.probability, there.belief.grid.probability)
    assert not np.asarray(state.task.team.frames.known)[0, 1]
