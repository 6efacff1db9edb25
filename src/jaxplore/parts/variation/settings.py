"""Settings of the variation of the true robot."""

from typing import Annotated

from pydantic import Field

from jaxplore._limits import MOST_NAMES
from jaxplore.parts.capability import Built, Capability, Surroundings
from jaxplore.parts.variation.truth import Variation
from jaxplore.settings.defaults import arguments, setting
from jaxplore.settings.sections import Delays, Interval, Positives, Real, Section


class VariationSettings(Section):
    """The variation of the true robot from episode to episode: see `jaxplore.Variation`.

    Args:
        parameters: intervals of parameters of the robot's model by their path, such as `drag`.
    """

    parameters: Annotated[dict[str, tuple[Real, Real]], Field(max_length=MOST_NAMES)] = Field(
        default_factory=dict
    )
    gain: Positives = setting(Variation, "gain")
    slip: Interval = setting(Variation, "slip")
    turn_slip: Interval = setting(Variation, "turn_slip")
    control_delay: Delays = setting(Variation, "control_delay")
    control_noise: Interval = setting(Variation, "control_noise")
    position_noise: Interval = setting(Variation, "position_noise")
    heading_noise: Interval = setting(Variation, "heading_noise")


def build_variation(given: VariationSettings, _: Surroundings) -> Built:
    """Build the variation; none at all by default, which leaves it out of the program."""
    parameters, drawn = given.parameters, arguments(given, Variation)
    if not parameters and drawn == arguments(VariationSettings(), Variation):
        return Built()
    return Built(disturbance=Variation(parameters, **drawn))


VARIATION = Capability(
    name="variation",
    meaning="variation of the true robot from episode to episode.",
    settings=VariationSettings,
    build=build_variation,
    dimensions=None,
    is_optional=False,
    is_on_board=False,
)
