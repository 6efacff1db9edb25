"""A search with a detector in a closed loop: a target is found when its class is certain."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import DifferentialDrive, ExplorationScenario, Lidar, OccupancyGrid, Perception
from jaxplore.control.base import Controller, Info
from jaxplore.maps import LabelledObject
from jaxplore.parts import Recognition, Targets
from jaxplore.parts.recognition.truth import Objects
from jaxplore.sensing import Detector
from jaxplore.simulation.loop import copy_tree, initial_loop_state, run_chunk

pytestmark = pytest.mark.long

SHAPE, RESOLUTION, STEPS = (20, 40), 0.2, 120  # 8 m x 4 m
CLASSES = ("barrel", "person")
DETECTOR = Detector(CLASSES, ((0.9, 0.1), (0.1, 0.9)), recall=0.9, reach=6.0)
TARGETS = ((3.0, 1.0), (4.5, 1.2))
OTHERS = (LabelledObject((4.0, 3.3), "barrel"),)
SENSOR = Lidar(32, 3.0, range_noise=0.0)
ROBOT = DifferentialDrive(max_speed=1.0, max_acceleration=2.0, drag=0.0, radius=0.25)


class Ahead(Controller):
    """Goes ahead, come what may."""

    def init(self):
        return ()

    def step(self, state, observation, belief=None, *, key):
        one, command = jnp.ones(()), jnp.array([1.0, 0.0])
        return command, state, Info(command[None], one[None], one[None], one, one > 0)

    def inspect(self, state, observation, belief=None, *, key, num_trajectories=50):
        raise NotImplementedError

    def at_period(self, control_period):
        return self


def scenario(objects=OTHERS, recognition=None, **more) -> ExplorationScenario:
    cells = np.full(SHAPE, 0.01)
    cells[0], cells[-1], cells[:, 0], cells[:, -1] = 0.99, 0.99, 0.99, 0.99
    perception = Perception(
        SENSOR,
        RESOLUTION,
        0.25,
        num_directions=4,
        node_spacing=0.4,
        parts=[] if recognition is None else [recognition],
    )
    return ExplorationScenario(
        OccupancyGrid(cells, RESOLUTION),
        ROBOT,
        SENSOR,
        (0.8, 2.0, 0.0),
        perception=perception,
        control_rate=20.0,
        sensing_rate=10.0,
        field_rate=5.0,
        truths=[*([] if objects is None else [Objects(objects)]), Targets(TARGETS)],
        **more,
    )


@pytest.fixture(scope="module")
def search():
    given = scenario(recognition=Recognition(DETECTOR, certainty=0.95, target="person"))
    controller = Ahead()
    state = initial_loop_state(controller, given, jax.random.key(0))
    count = jnp.asarray(STEPS, jnp.int32)
    state, rows, done = run_chunk(
        (controller, given, jax.random.key(1), count), copy_tree(state), STEPS
    )
    return given, state, jax.tree.map(lambda leaf: np.asarray(leaf)[: int(done)], rows)


def test_a_target_is_found_when_it_was_reported_and_not_when_it_is_seen(search) -> None:
    given, state, records = search
    objects = state.task.belief.parts["detector"]
    at = np.asarray(objects.reported_at)[:2, 1]
    seen = records.parts["targets"].targets_seen
    time = np.arange(len(seen)) * given.period
    # The record of a step holds what was measured at its beginning.
    expected = (time[:, None] >= at - 1e-6).sum(axis=1)
    np.testing.assert_array_equal(seen, expected)
    assert (at > np.asarray(objects.detected_at)[:2]).all()
    assert (np.asarray(objects.looks)[:2] > 1).all()
    # The search is over with the last report.
    assert len(seen) < STEPS
    assert expected[-1] == 2


def test_the_field_has_what_objects_add_and_nothing_of_earlier_looks(search) -> None:
    given, state, _ = search
    perception, field = given.perception, state.task.belief.information
    grid = state.task.belief.grid.with_probability(field.source)
    prior = perception.occupancy_prior
    plain = eqx.filter_jit(perception.field_sensor.field)(
        grid, perception.sensor_model, prior=prior
    )
    added = np.asarray(field.total - plain.total)
    # More than one bit of each object would be left over from the fields before.
    most = float(perception.part(Recognition).weight) * 3 * np.log(2.0)
    assert (added > -1e-3).all()
    assert 0.1 < added.max() < most


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, r"truths\[0\] is a Objects, and the perception has no part 'detector'"),
        ({"label": "dog"}, r"objects\[0\].label is 'dog'; accepted: barrel, person"),
        ({"label": "person"}, r"objects\[0\].label is 'person', the class of the targets"),
        ({"position": (0.1, 2.0)}, r"objects\[0\] is \[0.1.*, 2.0\]; accepted: a place in free"),
    ],
)
def test_objects_that_make_no_sense_are_refused(arguments, message) -> None:
    recognition = Recognition(DETECTOR, target="person") if arguments else None
    other = LabelledObject(**{"position": (4.0, 3.3), "label": "barrel"} | arguments)
    with pytest.raises(ValueError, match=message):
        scenario((other,), recognition)
