"""The time of a drive and the ages of messages: properties, and steps of clocks by hand."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.onboard.drive_clock import (
    CLOCK_TOLERANCE,
    MAX_STEP,
    STANDSTILL_SECONDS,
    DriveClock,
    Instant,
    Stamps,
)

PERIOD = 0.05
TIMES = st.floats(-1e9, 2e9)
DELAYS = st.floats(0.0, 0.3)


@given(st.lists(st.tuples(TIMES, st.floats(0.0, 5.0), st.booleans()), min_size=2, max_size=30))
def test_the_time_of_a_drive_never_goes_back(readings) -> None:
    clock, steady, last = DriveClock(PERIOD), 0.0, -math.inf
    for reading, passed, is_simulated in readings:
        steady += passed
        clock.advance(Instant(reading, steady, is_simulated))
        assert clock.time >= last
        last = clock.time


@given(TIMES, st.lists(st.floats(-30.0, 30.0), min_size=1, max_size=20))
def test_a_real_clock_that_steps_does_not_move_the_time_of_a_drive(began, steps) -> None:
    clock, steady, reading = DriveClock(PERIOD), 7.0, began
    clock.advance(Instant(reading, steady))
    for step in steps:
        steady += PERIOD
        reading += PERIOD + step
        clock.advance(Instant(reading, steady))
        if abs(abs(step) - MAX_STEP) > 1e-3:
            assert (clock.jump is not None) == (abs(step) > MAX_STEP)
    assert clock.time - began == pytest.approx(PERIOD * len(steps), abs=1e-5)


@pytest.mark.parametrize("rate", [0.2, 1.0, 5.0])
def test_a_simulated_clock_is_followed_at_its_rate(rate) -> None:
    clock = DriveClock(PERIOD)
    for index in range(100):
        # It moves ten times a second, and is read more often.
        steady = 0.02 * index
        clock.advance(Instant(3.0 + rate * math.floor(10.0 * steady) / 10.0, steady, True))
        assert clock.jump is None
        assert not clock.is_standing
    assert clock.time == pytest.approx(3.0 + rate * 1.9)
    for later in (0.0, STANDSTILL_SECONDS + 0.1):
        clock.advance(Instant(3.0 + rate * 1.9, steady + later, True))
    assert clock.is_standing
    clock.advance(Instant(0.0, steady + 1.0, True))
    assert clock.jump == f"the clock jumped by {-3.0 - rate * 1.9:.1f} s"
    assert not clock.is_standing


def test_a_clock_alone_jumps_where_it_goes_back_or_far() -> None:
    clock = DriveClock(PERIOD)
    for reading, jump in (
        *((5.0, None), (5.05, None), (4.95, None), (5.9, None)),
        *((-24.0, "the clock jumped by -29.9 s"), (-23.95, None)),
        *((6.05, "the clock jumped by 30.0 s"), (6.1, None)),
    ):
        clock.advance(Instant(reading))
        assert clock.jump == jump
    assert clock.time == pytest.approx(5.05 + 0.95 + 4 * PERIOD)


@pytest.mark.parametrize("now", [math.nan, math.inf])
def test_times_that_are_not_finite_are_refused(now) -> None:
    with pytest.raises(ValueError, match=r"now is (nan|inf); accepted"):
        Instant.of(now)


@given(st.lists(st.tuples(st.floats(0.0, 0.2), st.floats(-50.0, 50.0)), min_size=1, max_size=40))
def test_no_message_is_younger_than_its_arrival(messages) -> None:
    stamps, time = Stamps(PERIOD), 100.0
    for passed, ahead in messages:
        time += passed
        found = stamps.time_of(time + ahead, time, time)
        assert found is None or found <= time
        if found is not None and -CLOCK_TOLERANCE <= ahead < 0.0:
            assert found == pytest.approx(time + ahead)


@given(st.lists(st.tuples(st.booleans(), DELAYS, st.floats(0.06, 1e6)), min_size=1, max_size=40))
def test_stamps_ahead_of_time_never_make_true_ones_old(messages) -> None:
    """A true message with a constant delay is taken at its time, whatever is forged beside it."""
    stamps, time = Stamps(PERIOD), 100.0
    for is_forged, passed, ahead in messages:
        time += 0.01 + passed
        delay = 0.04
        found = stamps.time_of(time + (ahead if is_forged else -delay), time, time)
        assert found == pytest.approx(time if is_forged else time - delay)


@pytest.mark.parametrize("off", [-30.0, 30.0, -1e9])
def test_the_clock_of_a_sender_may_differ_or_step(off) -> None:
    stamps = Stamps(PERIOD)
    for index in range(10):
        time = 100.0 + 0.1 * index
        away = off if index >= 5 else 0.0
        assert stamps.time_of(time + away - 0.01, time, time) == pytest.approx(time, abs=0.011)
    differs = Stamps(PERIOD)
    assert differs.time_of(100.0 + off, 100.0, 100.0) == 100.0
    assert Stamps(PERIOD).time_of(0.0, 0.5, 7.0) == 7.0


def test_messages_that_are_held_up_are_old() -> None:
    stamps = Stamps(PERIOD)
    assert stamps.time_of(99.9, 100.0, 100.0) == pytest.approx(99.9)
    # Nothing arrives for 3 s, and then what was sent meanwhile.
    assert stamps.time_of(100.0, 103.0, 103.0) == pytest.approx(100.0)
    assert stamps.time_of(100.1, 103.01, 103.01) == pytest.approx(100.1)
    # An older one is left out.
    assert stamps.time_of(100.05, 103.02, 103.02) is None
