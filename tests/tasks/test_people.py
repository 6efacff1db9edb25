"""What a run says of people."""

import pytest

from jaxplore.tasks.registry import build, make_settings


@pytest.mark.parametrize("architecture", ["two-layer", "random-walk"])
def test_a_quadrotor_that_knows_nothing_of_people_says_so(architecture: str) -> None:
    people = {"number": 2, "speed": 1.0}
    settings = make_settings({"map": "zones", "architecture": architecture, "people": people})
    with pytest.warns(UserWarning, match=f"architecture {architecture} knows nothing of people"):
        build(settings)


@pytest.mark.parametrize(
    ("architecture", "number", "is_slow"),
    [("portfolio", 2, True), ("wander", 2, True), ("explorer", 0, False), ("two-layer", 0, False)],
)
def test_the_guard_slows_down_who_may_meet_people_on_the_ground(
    architecture: str, number: int, is_slow: bool
) -> None:
    settings = make_settings(
        {"map": "office", "architecture": architecture, "people": {"number": number}}
    )
    assert (build(settings).scenario.guard.occlusion is not None) is is_slow


def test_the_guard_does_not_slow_a_quadrotor_down() -> None:
    settings = make_settings(
        {"map": "zones", "architecture": "two-layer", "people": {"number": 2, "speed": 1.0}}
    )
    with pytest.warns(UserWarning, match="knows nothing of people"):
        made = build(settings)
    assert made.scenario.guard.occlusion is None
    assert made.scenario.perception.tracker is not None
