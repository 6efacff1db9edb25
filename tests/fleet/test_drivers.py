"""Each robot of a fleet is judged and stopped by its own guard, as a robot alone is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import Fleet
from jaxplore.control.fleet_controller import FleetBelief
from jaxplore.control.guard import MotionGuard, ScanPoints
from jaxplore.control.stops import JUMPED

pytestmark = pytest.mark.long

PLACES = ((1.0, 1.0, 0.3), (1.0, 2.0, -0.4), (1.9, 1.5, 0.1))
TIME = jnp.float32(0.1)


@pytest.fixture(scope="module")
def guarded(alone):
    return alone.with_guard(MotionGuard())


def test_a_jump_stops_the_robot_that_jumps_alone(guarded) -> None:
    fleet = Fleet(guarded, PLACES)
    driver, one = fleet.driver(), guarded.driver()
    states = np.stack(fleet.robot.split_state(fleet.start))
    states[:, 3] = 0.8
    seen = states.copy()
    seen[1, 0] += 1.0
    points = ScanPoints.blank(36, 0.0)._replace(
        points=jnp.asarray(np.random.default_rng(0).uniform(0.0, 3.0, (36, 2)), jnp.float32),
        is_point=jnp.ones(36, bool),
    )
    watch = driver.init(jnp.asarray(states.ravel()))

    @jax.jit
    def judge(watch, seen):
        return driver.judge(watch, seen.ravel(), jnp.asarray(states.ravel()), [points] * 3, TIME)

    trusted, judged = judge(watch, jnp.asarray(seen))
    assert judged.stop.tolist() == [0, JUMPED, 0]
    # Also where a robot is stopped, it is told where its guard takes it to be.
    np.testing.assert_allclose(judged.expected, seen.ravel())
    # The others stand where they were for one period, which is no fault yet.
    trusted = np.asarray(trusted).reshape(3, -1)
    np.testing.assert_array_equal(trusted[[0, 2]], seen[[0, 2]])
    assert np.isnan(trusted[1]).all()
    # The base of the second is told to brake, those of the others drive on.
    commands = np.float32([[0.4, 0.1], [np.nan, np.nan], [-0.3, 0.2]])

    @jax.jit
    def actuate(judged):
        return driver.actuate(
            judged, jnp.asarray(commands.ravel()), jnp.asarray(states.ravel()), [points] * 3
        )

    @jax.jit
    def brake(judged):
        return one.actuate(
            judged.robots[1], jnp.asarray(commands[1]), jnp.asarray(states[1]), points
        )

    control, after = actuate(judged)
    control = np.asarray(control).reshape(3, 2)
    np.testing.assert_array_equal(control[[0, 2]], commands[[0, 2]])
    braked, alone_after = brake(judged)
    np.testing.assert_allclose(control[1], braked, atol=1e-5)
    assert control[1, 0] < 0.0
    np.testing.assert_allclose(after.robots[1].expected, alone_after.expected, atol=1e-5)
    assert after.stop.tolist() == [0, JUMPED, 0]


def test_robots_have_guards_or_none_has(alone, guarded) -> None:
    with pytest.raises(ValueError, match=r"guard of robots\[1\] differs; accepted: as robots\[0\]"):
        Fleet([guarded, alone], PLACES[:2])
    given = Fleet(alone, PLACES[:2]).with_guard(MotionGuard())
    assert given.driver().has_guards
    assert not given.with_guard(None).driver().has_guards


def test_guards_need_a_controller_for_each_robot(alone, guarded, drive) -> None:
    fleet = Fleet(guarded, PLACES[:2])
    driver, belief = fleet.driver(drive(has_others=True)), FleetBelief((), fleet.identity)
    watch = driver.init(fleet.start)
    with pytest.raises(ValueError, match=r"controller of robots with guards is .*FleetController"):
        driver.decide((), watch, fleet.start, belief, (), TIME, jax.random.key(0))
