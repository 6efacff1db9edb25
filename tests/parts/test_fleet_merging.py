"""What the parts of a fleet of robots know together: in any order, however often they tell it."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jaxplore import Lidar, OccupancyGrid
from jaxplore.belief import Obstacles, Part
from jaxplore.belief.obstacles import Plans
from jaxplore.geometry.outlines import Outlines
from jaxplore.parts import AnomalyTest, IdlenessMap, Recognition
from jaxplore.parts.anomalies.reports import APPEARED, GONE, MAX_REPORTS
from jaxplore.parts.anomalies.robot import MATE_REACH, find_mate_beams
from jaxplore.sensing import Detector
from jaxplore.sensing.beams import Scan

ROBOTS, OBJECTS, CLASSES = 3, 4, 2
TIMES = st.one_of(st.just(np.inf), st.floats(0, 99, width=32))
RECOGNITION = Recognition(Detector(("a", "b"), ((0.9, 0.1), (0.2, 0.8))))
TEST = AnomalyTest(radius=1.0)
GRID = OccupancyGrid(np.full((4, 5), 0.1, np.float32), 1.0)
merge_classes, merge_reports = map(eqx.filter_jit, (RECOGNITION.merge, TEST.merge))


def equal(one, other) -> None:
    for left, right in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(left, right)


def row(states, robot):
    return jax.tree.map(lambda leaf: leaf[robot], states)


@given(hnp.arrays(np.float32, (ROBOTS, 2, 3), elements=TIMES), hnp.arrays(bool, ROBOTS))
def test_a_cell_was_seen_when_the_last_of_those_heard_saw_it(told, is_heard) -> None:
    found = IdlenessMap(20.0).merge(jnp.asarray(told[0]), jnp.asarray(told), jnp.asarray(is_heard))
    heard = [told[0], *(each for each, is_told in zip(told, is_heard, strict=True) if is_told)]
    np.testing.assert_array_equal(found, np.min(heard, axis=0))


@st.composite
def classes(draw):
    """Return what each robot knows of the objects, as looks leave it."""
    shape = (ROBOTS, OBJECTS)
    looks = draw(hnp.arrays(np.int32, shape, elements=st.integers(0, 3)))
    share = draw(hnp.arrays(np.float32, shape, elements=st.floats(0.125, 0.875, width=32)))
    at = draw(hnp.arrays(np.float32, (*shape, CLASSES), elements=TIMES))
    at[looks == 0] = np.inf
    first = np.where(looks > 0, np.minimum(at.min(axis=-1), 50.0), np.inf).astype(np.float32)
    shares = np.stack([share, 1.0 - share], axis=-1)
    shown = np.where(np.isfinite(at), share[..., None], 0.0).astype(np.float32)
    robots = [
        dataclasses.replace(
            RECOGNITION.init_slots(OBJECTS),
            log_probability=jnp.log(shares[i]),
            looks=jnp.asarray(looks[i]),
            detected_at=jnp.asarray(first[i]),
            reported_at=jnp.asarray(at[i]),
            reported_probability=jnp.asarray(shown[i]),
        )
        for i in range(ROBOTS)
    ]
    return jax.tree.map(lambda *each: jnp.stack(each), *robots)


@given(classes(), hnp.arrays(bool, ROBOTS))
def test_the_robot_that_has_looked_most_often_tells_the_classes(told, is_heard) -> None:
    mine = row(told, 0)
    found = merge_classes(mine, told, jnp.asarray(is_heard))
    heard = [0, *np.flatnonzero(is_heard)]
    for item in range(OBJECTS):
        looks = np.asarray(told.looks)[heard, item]
        best = heard[int(np.argmax(looks))]
        np.testing.assert_array_equal(found.looks[item], looks.max())
        np.testing.assert_array_equal(found.log_probability[item], told.log_probability[best, item])
        np.testing.assert_array_equal(
            found.detected_at[item], np.asarray(told.detected_at)[heard, item].min()
        )
        for label in range(CLASSES):
            times = np.asarray(told.reported_at)[heard, item, label]
            np.testing.assert_array_equal(found.reported_at[item, label], times.min())
            shares = np.asarray(told.reported_probability)[heard, item, label]
            assert float(found.reported_probability[item, label]) in shares[times == times.min()]
    # Who is told the same again learns nothing.
    again = jax.tree.map(lambda new, old: old.at[0].set(new), found, told)
    equal(merge_classes(found, again, jnp.asarray(is_heard)), found)


@st.composite
def reports(draw):
    """Return up to three reports and suspicions of each robot, as rows of its list."""
    entries = st.tuples(
        st.integers(0, 4), st.integers(0, 4), st.sampled_from([APPEARED, GONE]), TIMES
    )
    return [draw(st.lists(entries, max_size=3)) for _ in range(ROBOTS)]


def state_of(rows):
    """Return the state of a robot with such rows."""
    state = TEST.init(GRID)
    known, settled = state.reports, np.zeros(GRID.shape, bool)
    for x, y, kind, reported in rows:
        place = jnp.array([2.0 * x, 2.0 * y])  # nothing is nearer than two radii, or in one place
        known = known.open_suspicion(
            *(jnp.array(True), place, place, jnp.int32(kind), jnp.float32(1.0), jnp.zeros(3))
        )
        at = int(np.flatnonzero(np.asarray(known.kind) > 0)[-1])
        known = known._replace(reported=known.reported.at[at].set(reported))
        settled[min(y, 3), x] |= np.isfinite(reported)
    return dataclasses.replace(
        state, reports=known, is_settled=jnp.asarray(settled), change=jnp.ones(GRID.shape)
    )


def told_by(lists) -> set:
    """Return the places and kinds of the reports."""
    return {(2.0 * x, 2.0 * y, kind) for rows in lists for x, y, kind, at in rows if at < np.inf}


def in_list(found) -> set:
    known = found.reports
    return {
        (float(place[0]), float(place[1]), int(kind))
        for place, kind, at in zip(known.place, known.kind, known.reported, strict=True)
        if np.isfinite(at)
    }


@given(reports(), hnp.arrays(bool, ROBOTS))
def test_reports_are_passed_on_and_suspicions_are_not(lists, is_heard) -> None:
    states = [state_of(rows) for rows in lists]
    told = jax.tree.map(lambda *each: jnp.stack(each), *states)
    found = merge_reports(states[0], told, jnp.asarray(is_heard))
    heard = [lists[0], *(rows for rows, is_told in zip(lists, is_heard, strict=True) if is_told)]
    assert int((np.asarray(found.reports.kind) > 0).sum()) <= MAX_REPORTS
    if len(told_by(heard)) + len(lists[0]) <= MAX_REPORTS:
        assert in_list(found) == told_by(heard)
    # A report ends the suspicion of the same; others are as before.
    open_before = {(2.0 * x, 2.0 * y, kind) for x, y, kind, at in lists[0] if at == np.inf}
    is_open = np.asarray(found.reports.is_open)
    left = {
        (*map(float, found.reports.place[i]), int(found.reports.kind[i]))
        for i in np.flatnonzero(is_open)
    }
    assert left == open_before - told_by(heard)
    settled = np.asarray(found.is_settled)
    assert not np.asarray(found.change)[settled].any()
    assert (np.asarray(found.change)[~settled] == 1.0).all()
    again = jax.tree.map(lambda new, old: old.at[0].set(new), found, told)
    equal(merge_reports(found, again, jnp.asarray(is_heard)), found)


def test_a_robot_of_the_fleet_is_nothing_that_appeared() -> None:
    """Beams that end near a robot that tells its plan are left out, and no others."""
    sensor, pose = Lidar(8, 5.0), jnp.array([1.0, 2.0, 0.5])
    angles = 0.5 + np.asarray(sensor.beam_angles, np.float64)
    ranges = np.linspace(1.0, 3.0, 8)
    ends = np.array([1.0, 2.0]) + ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], -1)
    places = np.array([ends[2], ends[5] + [0.6, 0.0], ends[7]])
    outlines = Outlines.discs(places.astype(np.float32), np.float32([0.3, 0.3, 0.3]))
    plans = Plans.unknown(3, 4, jnp.float32(0.1))
    plans = plans.update(jnp.zeros((3, 4, 2)), jnp.array([True, True, False]))
    scan = Scan(jnp.asarray(ranges, jnp.float32), jnp.ones(8, bool))
    found = find_mate_beams(Obstacles(outlines, plans=plans), sensor, scan, pose)
    away = np.hypot(*np.moveaxis(ends[:, None] - places[:2], -1, 0)) - 0.3
    np.testing.assert_array_equal(found, (away <= MATE_REACH).any(axis=1))
    assert found[2]
    assert found[5]
    assert not found[7]
    assert find_mate_beams(Obstacles(outlines), sensor, scan, pose) is None
    assert find_mate_beams(None, sensor, scan, pose) is None


def test_a_part_without_a_merge_has_no_place_in_a_fleet() -> None:
    class Alone(Part):
        name = "alone"

    for each in (TEST, RECOGNITION, IdlenessMap()):
        each.check_fleet()
    with pytest.raises(ValueError, match="alone is a Alone; accepted in a fleet: parts with"):
        Alone().check_fleet()
