"""Goals for nav2's `NavigateToPose`, whose results decide, over real DDS."""

import itertools
import math

import pytest
from tests.ros import interfaces

MISSING = interfaces.missing()
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(bool(MISSING), reason=f"to make nav2_msgs there is no {MISSING}"),
]


@pytest.fixture(scope="module")
def seen(run_with_nav2):
    return run_with_nav2("navigate_program.py")


def test_an_exploration_is_driven_by_nav2_to_its_end(seen) -> None:
    assert seen["reasons"] == ["no place that is worth a visit is reachable"]
    assert seen["known"] > 0.9
    assert seen["goals"] == len(seen["asked"])


def test_without_a_server_the_node_waits_and_says_so(seen) -> None:
    assert "no action server /navigate_to_pose" in seen["waited"]


def test_results_decide_what_comes_next(seen) -> None:
    assert [what for what, *_ in seen["asked"]][:5] == [
        *("reject", "abort", "succeed", "cancel", "slow"),
    ]
    assert seen["outcomes"]["rejected"] == 1
    assert seen["outcomes"]["aborted"] == 1
    assert seen["outcomes"]["canceled"] == 1
    # What was aborted, cancelled, or took too long is not asked for again at once.
    given_up = [place for what, *place in seen["asked"] if what in ("abort", "cancel", "slow")]
    assert seen["dropped"] >= len(given_up)
    for before, after in itertools.pairwise(seen["asked"]):
        if before[0] in ("abort", "cancel", "slow"):
            assert math.dist(before[1:], after[1:]) > 0.4


def test_a_goal_that_takes_too_long_is_replaced(seen) -> None:
    assert seen["events"] == ["hangs", "replaced"]
