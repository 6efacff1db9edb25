"""Changes of what a pilot does: none is lost, however seldom they are taken."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore.onboard.options import Command, Mode
from jaxplore.ros.control import MOST_WAITING, Changes

REASONS = ("", "the clock jumped by -30.0 s", "the clock stands", "the scan is 0.31 s old")


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(st.sampled_from(Mode), st.sampled_from(REASONS), st.booleans()), max_size=40)
)
def test_every_reason_is_told_once_and_in_order(steps) -> None:
    changes, told, expected, last = Changes(), [], [], None
    for mode, reason, is_taken in steps:
        changes.add(Command(np.zeros(3), mode, reason, None))
        if (mode, reason) != last:
            expected.append((mode, reason))
        last = mode, reason
        if is_taken:
            told += changes.take()
    told += changes.take()
    assert [(each.mode, each.reason) for each in told] == expected
    assert changes.take() == []


def test_a_reason_with_another_number_is_no_change_and_what_waits_is_bounded() -> None:
    changes = Changes()
    for age in range(50):
        changes.add(Command(np.zeros(3), Mode.DRIVING, f"the scan is 0.{age} s old", None))
    assert [each.reason for each in changes.take()] == ["the scan is 0.0 s old"]
    for number in range(3 * MOST_WAITING):
        changes.add(Command(np.zeros(3), Mode.DRIVING, f"reason {number}", None))
    reasons = [each.reason for each in changes.take()]
    assert reasons == [f"reason {number}" for number in range(2 * MOST_WAITING, 3 * MOST_WAITING)]
