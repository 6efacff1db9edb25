"""Classes of objects: Bayes' rule, the information of a look, reports, and the field."""

import dataclasses
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import Lidar, OccupancyGrid
from jaxplore.information.field import InformationField
from jaxplore.parts import Look, ObjectClasses, Recognition
from jaxplore.sensing import Detector
from jaxplore.sensing.detector import Detections

CLASSES = ("person", "barrel", "door")
CONFUSION = ((0.7, 0.2, 0.1), (0.05, 0.9, 0.05), (0.0, 0.3, 0.7))
RECALL, REACH = (0.9, 0.6, 1.0), 4.0
DETECTOR = Detector(CLASSES, CONFUSION, recall=RECALL, reach=REACH)
PRIOR = (0.2, 0.5, 0.3)
RECOGNITION = Recognition(DETECTOR, prior=PRIOR, certainty=0.9, baseline=0.5, weight=20.0)
MISS = 3
informed = eqx.filter_jit(Recognition.add_information)


def likelihood(distance: float) -> np.ndarray:
    """Return P(outcome | class) in double precision; the last outcome is a miss."""
    recall = np.array(RECALL) * np.exp(-((distance / REACH) ** 2))
    return np.column_stack([recall[:, None] * np.array(CONFUSION), 1.0 - recall])


def entropy(probability: np.ndarray) -> float:
    return -sum(p * math.log(p) for p in probability if p > 0.0)


@pytest.fixture(scope="module")
def looks() -> tuple[np.ndarray, np.ndarray]:
    """Probabilities (60, 3) of classes, certain ones among them, and distances (60,)."""
    rng = np.random.default_rng(1)
    some = rng.dirichlet(np.full(3, 0.4), 60)
    some[0], some[1] = (1.0, 0.0, 0.0), (0.5, 0.5, 0.0)
    return some.astype(np.float32), rng.uniform(0.1, 9.0, 60).astype(np.float32)


def test_a_look_changes_the_classes_by_the_rule_of_bayes(looks) -> None:
    probability, distance = looks
    every = jax.vmap(RECOGNITION.posterior, (None, 0, None))
    found = jax.jit(jax.vmap(every, (0, None, 0)))(np.log(probability + 1e-30), range4(), distance)
    for row, (own, away) in enumerate(zip(probability.astype(float), distance, strict=True)):
        for outcome in range(4):
            # No look is proof: a likelihood of 0 counts as one in a million.
            joint = own * np.maximum(likelihood(away)[:, outcome], 1e-6)
            wanted = joint / joint.sum()
            np.testing.assert_allclose(np.exp(found[row, outcome]), wanted, atol=3e-5)


def range4() -> np.ndarray:
    return np.arange(4, dtype=np.int32)


def test_the_information_of_a_look_is_the_expected_divergence_over_all_outcomes(looks) -> None:
    probability, distance = looks
    found = jax.jit(jax.vmap(RECOGNITION.expected_information))(probability, distance)
    for own, away, value in zip(probability.astype(float), distance, found, strict=True):
        wanted = 0.0
        for outcome in range(4):
            joint = own * likelihood(away)[:, outcome]
            total = joint.sum()
            if total > 0.0:
                after = joint / total
                some = after > 0.0
                wanted += total * np.sum(after[some] * np.log(after[some] / own[some]))
        assert float(value) == pytest.approx(wanted, abs=2e-6)
        assert 0.0 <= float(value) <= entropy(own) + 1e-6


def known(probability, places, viewed_from=None) -> ObjectClasses:
    """Objects that were detected."""
    probability = np.asarray(probability, np.float32)
    number = len(probability)
    return ObjectClasses(
        log_probability=jnp.log(jnp.asarray(probability)),
        place=jnp.asarray(places, jnp.float32),
        detected_at=jnp.zeros(number),
        viewed_from=jnp.full((number, 2), jnp.inf)
        if viewed_from is None
        else jnp.asarray(viewed_from, jnp.float32),
        looks=jnp.ones(number, jnp.int32),
        reported_at=jnp.full(probability.shape, jnp.inf),
        reported_probability=jnp.zeros(probability.shape),
    )


def test_the_entropy_is_that_of_the_enumeration(looks) -> None:
    probability, _ = looks
    found = known(probability, np.zeros((60, 2))).entropy
    np.testing.assert_allclose(found, [entropy(each) for each in probability.astype(float)], 1e-4)


# One look after the other

update = jax.jit(Recognition.look)
PLACES = np.float32([[3.0, 0.0], [0.0, 2.0]])


def looked(state: ObjectClasses, labels, position, time, is_viewed=(True, True)) -> ObjectClasses:
    position = np.float32(position)
    away = np.hypot(*(PLACES - position).T).astype(np.float32)
    seen = Detections(np.int32(labels), np.array(is_viewed), away)
    return update(RECOGNITION, state, Look(seen, PLACES, position), np.float32(time))


def test_an_object_is_reported_when_its_class_is_certain_and_not_before() -> None:
    state, wanted = RECOGNITION.init_slots(2), np.array([PRIOR, PRIOR])
    # The first is detected at the second look; the miss before says nothing of it.
    rows = ((MISS, 1), (0, 1), (0, MISS), (0, 1), (0, 1))
    first = np.full((2, 3), np.inf)
    for time, labels in enumerate(rows):
        position = (0.6 * time, 0.0)
        state = looked(state, labels, position, time)
        for row, label in enumerate(labels):
            if time or label != MISS:
                away = np.hypot(*(PLACES[row] - position))
                joint = wanted[row] * np.maximum(likelihood(away)[:, label], 1e-6)
                wanted[row] = joint / joint.sum()
        np.testing.assert_allclose(state.probability, wanted, atol=1e-4)
        first = np.where((wanted >= 0.9) & np.isinf(first), time, first)
        np.testing.assert_array_equal(state.reported_at, first)
    assert np.isfinite(first).sum() == 2
    assert (np.asarray(state.reported_probability)[np.isfinite(first)] >= 0.9).all()
    np.testing.assert_array_equal(state.detected_at, [1.0, 0.0])
    np.testing.assert_array_equal(state.looks, [4, 5])
    np.testing.assert_array_equal(state.place, PLACES)


def test_looks_from_the_same_place_or_without_a_view_do_not_count() -> None:
    state = looked(RECOGNITION.init_slots(2), (0, 1), (0.0, 0.0), 0.0)
    near = looked(state, (0, 1), (0.3, 0.3), 1.0)
    blind = looked(state, (0, 1), (2.0, 0.3), 1.0, (False, False))
    for same in (near, blind):
        for one, other in zip(jax.tree.leaves(same), jax.tree.leaves(state), strict=True):
            np.testing.assert_array_equal(one, other)
    assert (np.asarray(looked(state, (0, 1), (0.5, 0.0), 1.0).looks) == 2).all()


# The field

SHAPE, RESOLUTION = (20, 30), 0.2  # 6 m x 4 m
SECTORS = 8


KNOWN = ((0.4, 0.3, 0.3), (0.2, 0.4, 0.4), (1.0, 0.0, 0.0), (0.4, 0.3, 0.3))
VIEW = math.radians(90.0)


class Informed(NamedTuple):
    """A hall with a wall in its lower half, a field, and the field with three objects."""

    grid: OccupancyGrid
    plain: InformationField
    objects: ObjectClasses
    field: InformationField


@pytest.fixture(scope="module")
def hall() -> Informed:
    cells = np.full(SHAPE, 0.01, np.float32)
    cells[:10, 15] = 0.99
    grid = OccupancyGrid(cells, RESOLUTION, (1.0, -2.0, 0.4))
    sectors = np.random.default_rng(2).uniform(0.0, 3.0, (SECTORS, 10, 15)).astype(np.float32)
    sums = np.concatenate([np.zeros((1, 10, 15)), np.cumsum(sectors, axis=0)]).astype(np.float32)
    frame = grid.frame.coarsen(2, 1.5)
    plain = InformationField(
        jnp.asarray(sectors), jnp.asarray(sums), grid.probability, frame, VIEW, SECTORS
    )
    places = grid.frame.to_world(jnp.array([[6.5, 10.5], [14.5, 21.5], [5.5, 5.5], [9.5, 3.5]]))
    objects = known(
        KNOWN,
        places,
        [np.asarray(frame.to_world(jnp.array([2.5, 6.5]))), (90, 90), (90, 90), (90, 90)],
    )
    # The last one was never detected.
    objects = dataclasses.replace(objects, detected_at=jnp.array([0.0, 0.0, 0.0, jnp.inf]))
    return Informed(
        grid, plain, objects, informed(RECOGNITION, objects, plain, grid, Lidar(8, 3.0))
    )


def wall_share(cells: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """Return the length of a line within the wall by samples, all in cells (row, column)."""
    way = start + np.linspace(0.0, 1.0, 2001)[:, None] * (end - start)
    spots = np.floor(way).astype(int)
    return float((cells[spots[:, 0], spots[:, 1]] > 0.5).mean()) * np.hypot(*(end - start))


@pytest.mark.parametrize(("max_range", "least"), [(3.0, 40), (1.4, 20)])
def test_the_field_adds_the_information_of_a_look_to_the_sector_of_each_object(
    hall, max_range, least
) -> None:
    # With the short range only a window of the field changes.
    field = informed(RECOGNITION, hall.objects, hall.plain, hall.grid, Lidar(8, max_range))
    added = np.asarray(field.sectors) - np.asarray(hall.plain.sectors)
    cells = np.asarray(hall.grid.probability)
    to_grid = hall.grid.frame.to_grid
    places, viewed = (
        np.asarray(to_grid(each[:2]), np.float64)
        for each in (hall.objects.place, hall.objects.viewed_from)
    )
    checked = 0
    for row, column in np.ndindex(10, 15):
        node = np.array([2.0 * row + 1.5, 2.0 * column + 1.5])
        wanted, is_clear = np.zeros(SECTORS), True
        # Of four objects, one is certain and one is not known.
        for place, last, own in zip(places, viewed, KNOWN, strict=False):
            down, right = place - node
            away, apart = (RESOLUTION * np.hypot(*(each - node)) for each in (place, last))
            hidden = wall_share(cells, node, place)
            bearing = math.atan2(down, right) % (2 * math.pi) / (2 * math.pi / SECTORS)
            # Left out: lines that only touch a corner of the wall, bearings between two sectors.
            is_clear &= not 0.0 < hidden < 0.6 and abs(bearing - round(bearing)) > 1e-3
            if hidden == 0.0 and away <= max_range and apart >= 0.5:
                table = likelihood(away)
                given = sum(p * entropy(each) for p, each in zip(own, table, strict=True))
                wanted[int(bearing)] += 20.0 * (entropy(np.array(own) @ table) - given)
        if is_clear:
            np.testing.assert_allclose(added[:, row, column], wanted, atol=2e-4)
            checked += wanted.any()
    assert checked > least


def test_the_sums_of_the_field_are_those_of_its_sectors(hall) -> None:
    np.testing.assert_allclose(
        hall.field.cumulative[1:], np.cumsum(hall.field.sectors, axis=0), atol=1e-4
    )
    np.testing.assert_array_equal(hall.field.cumulative[0], 0.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"prior": (0.5, 0.3, 0.3)}, "prior sums to 1.1; accepted: probabilities that sum to 1"),
        ({"prior": (0.5, 0.5)}, r"prior has shape \(2,\); accepted: \(3,\)"),
        ({"target": "dog"}, "target is 'dog'; accepted: person, barrel, door"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments, message) -> None:
    with pytest.raises(ValueError, match=message):
        Recognition(**{"detector": DETECTOR} | arguments)
