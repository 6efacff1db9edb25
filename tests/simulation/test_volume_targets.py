"""A quadrotor that looks for targets in a volume: what counts as found, and when it ends."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from tests.kinds import volume

from jaxplore.belief.gain import Gain
from jaxplore.simulation.volume.scenario import VolumeScenario
from jaxplore.simulation.volume.true_volume import TrueVolume

TARGETS = ((2.5, 2.0, 1.2), (6.5, 1.0, 1.2))
"""One ahead of the start, and one behind the wall."""
find = eqx.filter_jit(TrueVolume.sees)


@pytest.fixture(scope="module")
def search() -> VolumeScenario:
    return volume(targets=TARGETS)


def look(search, x: float, y: float, yaw: float) -> list[bool]:
    """Return which targets are seen from a place at the height of the start."""
    state = search.robot.at_pose(x, y, yaw, -1.2)
    truth = TrueVolume(search.world, None)
    return np.asarray(find(truth, search.sensors, state, search.targets)).tolist()


def test_a_target_is_found_where_the_camera_sees_it(search) -> None:
    assert look(search, 1.2, 2.0, 0.0) == [True, False]
    # Facing away from it, then from behind it and before the wall.
    assert look(search, 1.2, 2.0, np.pi) == [False, False]
    assert look(search, 2.7, 1.0, 0.0) == [False, False]
    assert look(search, 4.5, 1.0, 0.0) == [False, True]


@pytest.mark.long
def test_it_ends_when_all_are_found_and_not_by_coverage(search) -> None:
    begin = eqx.filter_jit(lambda scenario: scenario.init(None)[0])(search)
    known = {"num_known": jnp.int32(10**6), "gain": Gain(jnp.zeros(()), jnp.float32(1e6))}
    for found, is_over in (([True, False], False), ([True, True], True)):
        at = begin._replace(is_seen=jnp.asarray(found), **known)
        assert bool(search.is_unfinished(at)) != is_over
        assert not bool(search.is_given_up(at))
    assert not bool(volume().is_unfinished(at._replace(is_seen=jnp.zeros(0, bool))))


def test_targets_that_cannot_be_seen_are_named() -> None:
    for place in ((-1.0, 2.0, 1.2), (3.1, 0.5, 1.2), (2.0, 2.0, 0.05)):
        with pytest.raises(ValueError, match=r"targets\[1\] is \(.*\); accepted: a free voxel"):
            volume(targets=(TARGETS[0], place))
    with pytest.raises(ValueError, match=r"targets .*accepted: "):
        volume(targets=[(1.0, 2.0)])
