"""Settings of the test for what differs from the known map."""

from typing import Annotated

from pydantic import Field

from jaxplore.parts.anomalies.robot import AnomalyTest
from jaxplore.parts.anomalies.truth import find_anomalies
from jaxplore.parts.capability import Built, Capability, Surroundings
from jaxplore.settings.defaults import arguments, setting
from jaxplore.settings.sections import Length, Looks, NonNegative, Positive, Probability, Section


class AnomalySettings(Section):
    """The test for what differs from the known map: see `jaxplore.parts.AnomalyTest`."""

    false_alarms: Probability = setting(AnomalyTest, "false_alarms")
    outliers: Probability = setting(AnomalyTest, "outliers")
    near: Length = setting(AnomalyTest, "near")
    baseline: NonNegative = setting(AnomalyTest, "baseline")
    looks: Looks = setting(AnomalyTest, "looks")
    stay: NonNegative = setting(AnomalyTest, "stay")
    expiry: Positive = setting(AnomalyTest, "expiry")
    attention: Annotated[float, Field(ge=0, lt=1)] = setting(AnomalyTest, "attention")
    radius: Positive = setting(AnomalyTest, "radius")
    range_noise: Positive | None = setting(AnomalyTest, "range_noise")


def build_anomalies(given: AnomalySettings, around: Surroundings) -> Built:
    """Build the test, and what differs in a world."""
    numbers = arguments(given, AnomalyTest)
    if around.world is None:
        return Built(AnomalyTest(**numbers))
    test = AnomalyTest(forbidden=around.world.forbidden, **numbers)
    return Built(test, find_anomalies(around.world))


ANOMALIES = Capability(
    name="anomalies",
    meaning="the test for what differs from the known map; none when absent. It needs a watch.",
    settings=AnomalySettings,
    build=build_anomalies,
)
