"""nav2's controller server: an action client drives a simulated robot over real DDS."""

import pytest
from tests.ros import interfaces

MISSING = interfaces.missing()
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(bool(MISSING), reason=f"to make nav2_msgs there is no {MISSING}"),
]
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
"""Values of `action_msgs/GoalStatus`."""
AT_REST = 0.06


@pytest.fixture(scope="module")
def seen(run_with_nav2, tmp_path_factory):
    return run_with_nav2("controller_program.py", str(tmp_path_factory.mktemp("served")))


def is_at_rest(end: dict) -> bool:
    speed, turn_rate = end["speed"]
    return speed <= AT_REST and 0.5 * turn_rate <= AT_REST


def test_the_lifecycle_is_that_of_a_server_of_nav2(seen) -> None:
    assert seen["unconfigured"] == "unconfigured"
    transitions = ("configured", "activated", "deactivated", "cleaned")
    assert [seen[name] for name in transitions] == [True] * 4
    # Goals are rejected before it is active.
    assert seen["inactive"]
    assert seen["bond"] == ["controller_server", True]


def test_a_goal_is_reached_with_its_heading_and_feedback_tells_the_way(seen) -> None:
    end = seen["reached"]
    assert (end["status"], end["code"], end["text"]) == (SUCCEEDED, 0, "")
    assert is_at_rest(end)
    distances = [distance for distance, _ in seen["feedback"]]
    assert distances[0] == pytest.approx(1.5, abs=0.1)
    assert distances[-1] < 0.3
    assert max(speed for _, speed in seen["feedback"]) > 0.2


def test_a_newer_goal_replaces_an_older_one_without_a_stop(seen) -> None:
    end = seen["replaced"]
    assert (end["status"], end["code"]) == (ABORTED, 0)
    assert end["text"] == "replaced by a newer goal"
    assert seen["slowest"] > 0.1
    first, second = seen["both"]
    assert (first["status"], first["code"]) == (ABORTED, 0)
    assert second["status"] == SUCCEEDED


def test_a_cancelled_goal_ends_with_the_robot_at_rest(seen) -> None:
    assert seen["cancelled"]["status"] == CANCELED
    assert is_at_rest(seen["cancelled"])


@pytest.mark.parametrize(
    ("name", "code", "said"),
    [
        ("empty", 103, "path has no poses"),
        ("nan", 103, "nan"),
        ("frame", 102, "no transform from the frame 'moon'"),
        ("controller", 101, "controller_id is 'DWB'"),
        ("goal_checker", 100, "goal_checker_id is 'sloppy'"),
    ],
)
def test_a_goal_that_is_none_ends_with_the_code_of_nav2_and_the_robot_at_rest(
    seen, name, code, said
) -> None:
    end = seen["refused"][name]
    assert (end["status"], end["code"]) == (ABORTED, code)
    assert said in end["text"]
    assert is_at_rest(end)


def test_a_goal_behind_a_wall_is_given_up_and_parameters_change_meanwhile(seen) -> None:
    assert (seen["wall"]["status"], seen["wall"]["code"]) == (ABORTED, 105)
    assert seen["wall"]["text"] == "the robot moved less than 1 m in 3 s"
    assert is_at_rest(seen["wall"])
    assert seen["back"]["status"] == SUCCEEDED
    assert seen["set"] == []
    (reason,) = seen["unset"]
    assert reason.startswith("xy_goal_tolerance is -1.0; accepted: ")


def test_a_limit_of_the_speed_is_kept(seen) -> None:
    # Half of 1 m/s.
    assert seen["fastest"] < 0.55


def test_a_server_that_is_deactivated_stops_the_robot(seen) -> None:
    assert (seen["stopped"]["status"], seen["stopped"]["code"]) == (ABORTED, 0)
    assert is_at_rest(seen["stopped"])


def test_a_costmap_may_stand_for_the_scans(seen) -> None:
    assert seen["no_costmap"]["code"] == 107
    assert seen["no_costmap"]["text"].startswith("no costmap on /local_costmap/costmap yet")
    assert seen["virtual_wall"]["code"] == 105
    assert seen["driven"] < 0.7 - 0.2
    assert seen["open"]["status"] == SUCCEEDED


def test_the_robot_touches_nothing_and_nothing_compiles(seen) -> None:
    assert seen["robot"]["contacts"] == 0
    assert [seen[name]["compiled"] for name in ("scan", "costmap")] == [0, 0]
    assert [seen[f"{name}_code"] for name in ("scan", "costmap")] == [130, 130]


def test_without_nav2_msgs_one_line_says_what_is_missing(fails) -> None:
    """This process has no path to the generated types."""
    line = fails("controller", "--no-animation", "--set", "node.map_size=20")
    assert line.startswith("jaxplore: nav2_msgs is not installed, which has the actions of nav2; ")
