"""Nodes by clocks that jump and stand still, without ROS."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from jaxplore.onboard.drive_clock import STANDSTILL_SECONDS, Instant
from jaxplore.onboard.goals import ChosenGoal
from jaxplore.ros.control import LOOKS, Pace
from jaxplore.ros.goal import MAX_AGE, GoalNode
from jaxplore.ros.messages import Odometry
from jaxplore.settings.node import NodeSettings

PERIOD = 0.05


class FakeLink:
    """A connection whose clock is a function of real time, and which keeps the states."""

    def __init__(self, clock) -> None:
        names = ("PoseStamped", "String", "OccupancyGrid", "Odometry")
        self.ros = SimpleNamespace(**dict.fromkeys(names, SimpleNamespace))
        self.clock, self.steady, self.states, self.warned = clock, 0.0, [], []
        self.num_warnings = {}
        self.is_simulated = False

    def subscribe(self, *_, **__) -> None: ...

    def publisher(self, _, topic, **__):
        def publish(message) -> None:
            if topic == "~/state":
                self.states.append(json.loads(message.data))

        return SimpleNamespace(publish=publish)

    def topic(self, name) -> str:
        return name

    def frame(self, name) -> str:
        return name

    def now(self) -> float:
        return self.clock(self.steady)

    def instant(self) -> Instant:
        return Instant(self.now(), self.steady, self.is_simulated)

    def warn(self, _, text) -> None:
        self.warned.append(text)

    def info(self, _) -> None: ...


def chosen(clock, seconds, poses_until=np.inf, is_simulated=False):
    """Let a node choose goals for some seconds; return its states and the times of its choices."""
    link, times = FakeLink(clock), []
    link.is_simulated = is_simulated

    def update(now, *_):
        times.append(now)
        return ChosenGoal(np.zeros(3), 1.0, 1.0)

    chooser = SimpleNamespace(update=update, num_dropped=0)
    node = GoalNode(link, chooser, NodeSettings(mode="goal"), 0.1)
    node._map, node._frame = ("a grid", np.zeros(2)), "map"
    node._publish_goal = lambda *_: None

    def wait(step) -> bool:
        link.steady += step
        if link.steady <= poses_until:
            pose = Odometry(link.now(), "map", np.zeros(3), None, link.instant())
            node._take_pose(pose)
        return link.steady > seconds

    node.run(SimpleNamespace(wait=wait))
    return link, times


@pytest.mark.parametrize("jump", [-30.0, 30.0])
def test_goals_are_chosen_on_after_the_clock_has_jumped(jump) -> None:
    link, times = chosen(lambda t: 500.0 + t + jump * (t > 10.5), 20.0)
    assert {each["mode"] for each in link.states} == {"driving"}
    assert link.warned == [f"the clock jumped by {jump:.1f} s"]
    # The times for which goals are kept or dropped have no jump.
    np.testing.assert_allclose(np.diff(times), 1.0)


@pytest.mark.parametrize("jump", [-30.0, 30.0])
def test_a_pose_that_is_old_is_so_after_a_jump_as_well(jump) -> None:
    link, _ = chosen(lambda t: 500.0 + t + jump * (t > 10.5), 20.0, poses_until=8.0)
    modes = [each["mode"] for each in link.states]
    assert modes == ["driving"] * int(8 + MAX_AGE) + ["waiting"] * 7


def test_no_goal_is_chosen_while_a_simulated_clock_stands() -> None:
    link, _ = chosen(lambda t: min(t, 5.0), 9.0, is_simulated=True)
    assert [each["mode"] for each in link.states] == ["driving"] * 5 + ["waiting"] * 4
    assert link.states[-1]["reason"] == "the simulated clock stands still"


def test_commands_are_due_after_a_period_of_real_time() -> None:
    pace = Pace(PERIOD)
    assert pace.is_due(1.0, Instant(5.0, 1.0))
    pace.begin(Instant(5.0, 1.0))
    for clock in (-100.0, 5.0, 100.0):
        assert pace.wait_for(1.0, Instant(clock, 1.01)) == pytest.approx(0.04)
        assert not pace.is_due(1.0, Instant(clock, 1.04))
        assert pace.is_due(0.25, Instant(clock, 1.02))
        assert pace.is_due(1.0, Instant(clock, 1.0501))


@pytest.mark.parametrize("rate", [0.2, 5.0])
def test_commands_are_due_after_a_period_of_simulated_time(rate) -> None:
    pace, steady, due = Pace(PERIOD), 0.0, []
    while len(due) < 20:
        now = Instant(rate * steady, steady, True)
        if pace.is_due(1.0, now):
            pace.begin(now)
            due.append(now.clock)
        wait = pace.wait_for(1.0, now)
        assert wait <= PERIOD / LOOKS + 1e-9
        steady += max(wait, 1e-4)
    assert np.diff(due).min() >= PERIOD - 1e-9
    assert np.diff(due).max() <= PERIOD + rate * PERIOD / LOOKS + 1e-6


def test_commands_go_on_while_a_simulated_clock_stands_and_when_it_goes_back() -> None:
    pace = Pace(PERIOD)
    pace.begin(Instant(9.0, 1.0, True))
    assert not pace.is_due(1.0, Instant(9.0, 1.2, True))
    late = 1.2 + STANDSTILL_SECONDS + 0.01
    assert pace.is_due(1.0, Instant(9.0, late, True))
    pace.begin(Instant(9.0, late, True))
    assert not pace.is_due(1.0, Instant(9.0, late + 0.04, True))
    assert pace.is_due(1.0, Instant(9.0, late + 0.06, True))
    assert pace.is_due(1.0, Instant(0.0, late + 0.001, True))
