"""What a run says of people."""

import pytest

from jaxplore.build.tasks import build, make_settings


@pytest.mark.parametrize("architecture", ["two-layer", "random-walk"])
def test_a_quadrotor_that_knows_nothing_of_people_says_so(architecture: str) -> None:
    people = {"number": 2, "speed": 1.0}
    settings = make_settings({"map": "zones", "architecture": architecture, "people": people})
    with pytest.warns(UserWarning, match=f"architecture {architecture} knows nothing of people"):
        build(settings)
