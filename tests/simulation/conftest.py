import dataclasses

import jax
import numpy as np
import pytest

from jaxplore import DifferentialDrive, Faults, Lidar, OccupancyGrid, Perception, explorer
from jaxplore.simulation.exploration.scenario import ExplorationScenario

SIZE = (40, 60)


def u_shaped_world(seed: int | None = None) -> OccupancyGrid:
    """6 x 4 m with a U-shaped wall that opens away from what is to be found; or random pillars."""
    world = np.zeros(SIZE, np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 1.0, 1.0, 1.0, 1.0
    if seed is None:
        world[8:32, 40] = world[8, 22:41] = world[31, 22:41] = 1.0
    else:
        rng = np.random.default_rng(seed)
        for row, column in rng.integers((12, 25), (36, 56), (5, 2)):
            world[row : row + 2, column : column + 2] = 1.0
    return OccupancyGrid(world, 0.1)


@pytest.fixture(scope="session")
def u_shaped():
    return u_shaped_world()


@pytest.fixture(scope="session")
def other_world():
    return u_shaped_world(seed=1)


@pytest.fixture(scope="session")
def make():
    """Return a maker of small experiments that all share one compiled loop."""
    robot = DifferentialDrive(max_speed=1.0)
    lidar = Lidar(num_beams=72, max_range=1.5, range_noise=0.01)

    def make(world=None, start=(3.0, 2.0, 0.0), *, rates=None, faults=None, target=0.97, **costs):
        world = u_shaped_world() if world is None else world
        perception = Perception(lidar, 0.1, 0.2, num_directions=16, margin=0.05)
        # So that runs with a fault are the same program, there are faults always.
        scenario = ExplorationScenario(
            world,
            robot,
            lidar,
            start,
            perception=perception,
            target_coverage=target,
            **({} if rates is None else rates),
        ).with_disturbances([Faults() if faults is None else faults])
        return explorer(robot, horizon=30, num_samples=128, **costs), scenario

    return make


@pytest.fixture(scope="session")
def check_frames():
    """Return a check that the looks at a run are in order, and that the last one is its end."""

    def check(recording) -> None:
        steps = [frame.step for frame in recording.frames]
        assert steps[0] == 0
        assert steps[-1] == recording.num_steps
        assert steps == sorted(set(steps))
        last = recording.frames[-1]
        np.testing.assert_array_equal(last.state, recording.records.state[-1])
        expected = np.round(255 * recording.belief).astype(np.uint8)
        np.testing.assert_array_equal(last.probability, expected)

    return check


@pytest.fixture(scope="session")
def check_equal():
    """Return a check that two runs are equal to the bit, but for their times."""

    def check(one, other) -> None:
        first, second = (
            {field.name: getattr(each.recording, field.name) for field in fields}
            for each in (one, other)
            for fields in [dataclasses.fields(each.recording)]
        )
        del first["timing"], second["timing"]
        frames = [[vars(frame) for frame in each.pop("frames")] for each in (first, second)]
        for mine, theirs in ((first, second), frames):
            leaves = [jax.tree.flatten(each) for each in (mine, theirs)]
            assert leaves[0][1] == leaves[1][1]
            for a, b in zip(leaves[0][0], leaves[1][0], strict=True):
                np.testing.assert_array_equal(a, b)
        metrics = [each.metrics.as_dict() | {"compute": None} for each in (one, other)]
        assert metrics[0] == metrics[1]

    return check
