"""Monitors: what they are shown of a run, and what they may ask for."""

import itertools
import math

import jax
import numpy as np
import pytest

from jaxplore import simulate
from jaxplore.parameters import get_parameters
from jaxplore.simulation.loop import run_chunk
from jaxplore.simulation.monitor import Monitor, Requests

pytestmark = pytest.mark.long

STEPS = 40
KEY = jax.random.key(3)
WEIGHT = "cost.information.weight"


class Notes(Monitor):
    """Keeps what it is shown, and asks for what a list says, one entry after each update."""

    def __init__(self, *asked: Requests, every: float = 0.1) -> None:
        self.asked = list(asked) or [Requests()]
        self.every, self.updates, self.refused = every, [], []
        self.began = self.ended = None
        self.num_ends = 0

    def begin(self, recording, controller) -> None:
        assert self.began is None
        self.began, self.parameters = recording, get_parameters(controller)

    def is_due(self, simulated: float, elapsed: float) -> bool:
        return simulated > self.every - 1e-6

    def show(self, update) -> None:
        self.updates.append(update)

    def requests(self) -> Requests:
        return self.asked[min(len(self.updates), len(self.asked) - 1)]

    def refuse(self, message: str) -> None:
        self.refused.append(message)

    def end(self, recording) -> None:
        self.ended = recording
        self.num_ends += 1

    @property
    def steps(self) -> list[int]:
        return [each.frame.step for each in self.updates]


@pytest.fixture(scope="module")
def run_of(make):
    controller, scenario = make()

    def run(*monitors, steps=STEPS, **changes):
        return simulate(
            controller, scenario, steps, key=KEY, num_trajectories=8, monitors=monitors, **changes
        )

    return run


@pytest.fixture(scope="module")
def plain(run_of):
    return run_of()


def test_monitors_see_every_step_once_and_change_nothing(run_of, plain, check_equal) -> None:
    fast, slow = Notes(), Notes(every=0.3)
    watched = run_of(fast, slow)
    check_equal(watched, plain)
    for notes, every in ((fast, 5), (slow, 15)):
        assert notes.began.num_steps == 0
        np.testing.assert_array_equal(notes.began.world, plain.recording.world)
        assert len(notes.began.frames) == 1
        assert notes.ended is watched.recording
        assert notes.steps == list(range(every, STEPS + 1, every))
        seen = [each.records.state for each in notes.updates]
        done = notes.steps[-1]
        np.testing.assert_array_equal(np.concatenate(seen), plain.recording.records.state[:done])
        times = np.concatenate([each.time for each in notes.updates])
        np.testing.assert_allclose(times, 0.02 * np.arange(1, done + 1))
    last = fast.updates[-1].frame
    np.testing.assert_array_equal(last.state, plain.recording.records.state[-1])
    assert len(last.samples) == 8
    assert "coverage" in fast.updates[-1].text


def test_a_parameter_that_changes_acts_from_the_next_step_on_and_compiles_nothing(
    run_of, plain
) -> None:
    new = Requests({WEIGHT: 0.0})
    notes = Notes(Requests(), Requests(), new)
    size = run_chunk._cached._cache_size()
    changed = run_of(notes)
    assert run_chunk._cached._cache_size() == size
    states = [each.recording.records.state for each in (changed, plain)]
    np.testing.assert_array_equal(states[0][:10], states[1][:10])
    assert not np.array_equal(states[0][10:], states[1][10:])
    assert notes.parameters[WEIGHT] == 2.0


def test_a_parameter_that_is_not_accepted_is_refused_once_and_the_run_goes_on(
    run_of, plain, check_equal
) -> None:
    notes = Notes(Requests({"cost.beauty.weight": 1.0, WEIGHT: float("nan")}))
    check_equal(run_of(notes), plain)
    assert [message.split(";")[0] for message in notes.refused] == [
        "parameter cost.beauty.weight is not known",
        f"parameter {WEIGHT} is nan",
    ]


def test_a_run_that_is_stopped_is_interrupted_and_can_be_resumed(
    run_of, plain, check_equal
) -> None:
    stopped = run_of(Notes(Requests(), Requests(), Requests(is_stopped=True)))
    assert stopped.recording.num_steps == 10
    assert stopped.recording.is_interrupted
    resumed = Notes()
    check_equal(run_of(resumed, resume=stopped), plain)
    assert resumed.steps == list(range(15, STEPS + 1, 5))


def test_a_paused_run_takes_single_steps(run_of, plain, check_equal) -> None:
    class Steps(Notes):
        looks = itertools.count()

        def requests(self) -> Requests:
            steps = self.steps
            if len(steps) == 2:
                # Ten looks without a step, then single steps.
                return Requests(is_paused=True, single_steps=next(self.looks) > 10)
            if len(steps) == 3:
                return Requests(is_paused=True, single_steps=1 + (next(self.looks) > 20))
            return Requests()

        def is_due(self, simulated: float, elapsed: float) -> bool:
            return True

    notes = Steps()
    check_equal(run_of(notes), plain)
    assert notes.steps[:4] == [2, 4, 5, 6]
    assert next(notes.looks) == 22


def test_a_monitor_sets_how_long_the_run_goes_on_by_itself(run_of, plain, check_equal) -> None:
    paces = []

    class Patient(Notes):
        def is_due(self, simulated: float, elapsed: float) -> bool:
            return True

        def longest_chunk(self, pace: float) -> float:
            paces.append(pace)
            return 0.4

    alone = Patient()
    check_equal(run_of(alone), plain)
    # Frames of the recording, every 0.05 s at first, end chunks as well.
    assert set(np.diff(alone.steps)) <= {2, 3, 4}
    assert paces[0] == math.inf or paces[0] > 0.0
    assert all(pace > 0.0 for pace in paces)
    # The least patient of several decides.
    check_equal(run_of(Patient(), Notes()), plain)


def test_the_speed_is_held(run_of, monkeypatch) -> None:
    class Clock:
        now = 0.0

        def monotonic(self) -> float:
            return self.now

        def sleep(self, seconds: float) -> None:
            assert seconds > 0.0
            self.now += seconds

    clock = Clock()
    monkeypatch.setattr("jaxplore.simulation.monitor.time", clock)
    run_of(Notes(Requests(speed=2.0)))
    # The speed is held from the end of the first chunk on, a frame of two steps.
    assert clock.now == pytest.approx((STEPS - 2) * 0.02 / 2.0)


def test_if_one_does_not_begin_those_before_it_are_told_of_the_end(run_of) -> None:
    class Refusal(Notes):
        def begin(self, recording, controller) -> None:
            raise ValueError("it does not begin")

    first, refusal, last = Notes(), Refusal(), Notes()
    with pytest.raises(ValueError, match="it does not begin"):
        run_of(first, refusal, last)
    assert first.began is not None
    assert first.ended is None
    assert [each.num_ends for each in (first, refusal, last)] == [1, 0, 0]
