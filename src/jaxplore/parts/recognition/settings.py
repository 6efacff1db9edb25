"""Settings of the detector of objects, and of the update of their classes."""

from typing import Annotated

from pydantic import Field

from jaxplore._limits import MOST_NAMES
from jaxplore.parts.capability import Built, Capability, Surroundings
from jaxplore.parts.recognition.robot import Recognition
from jaxplore.parts.recognition.truth import Objects
from jaxplore.sensing.detector import Detector
from jaxplore.settings.defaults import arguments, setting
from jaxplore.settings.sections import Fraction, NonNegative, Positive, Section, Share

Names = Annotated[tuple[str, ...], Field(max_length=MOST_NAMES)]
Fractions = Annotated[tuple[Fraction, ...], Field(max_length=MOST_NAMES)]


class DetectorSettings(Section):
    """The detector of objects, and the update of their classes: see `jaxplore.sensing.Detector` and
    `jaxplore.parts.Recognition`.

    Args:
        classes: names of the classes, at least two.
        confusion: matrix of the classes; row c has the probability of each label for an object of
            class c that is detected. Its rows sum to 1.
    """

    classes: Names
    confusion: Annotated[tuple[Fractions, ...], Field(max_length=MOST_NAMES)]
    recall: Share | Annotated[tuple[Share, ...], Field(max_length=MOST_NAMES)] = setting(
        Detector, "recall"
    )
    reach: Positive = setting(Detector, "reach")
    prior: Fractions | None = setting(Recognition, "prior")
    certainty: Annotated[float, Field(gt=0.5, lt=1)] = setting(Recognition, "certainty")
    baseline: NonNegative = setting(Recognition, "baseline")
    weight: NonNegative = setting(Recognition, "weight")
    target: str | None = setting(Recognition, "target")


def build_recognition(given: DetectorSettings, around: Surroundings) -> Built:
    """Build the detector with the update of classes, and the objects of a world."""
    detector = Detector(given.classes, given.confusion, **arguments(given, Detector))
    recognition = Recognition(detector, **arguments(given, Recognition))
    return Built(recognition, None if around.world is None else Objects(around.world.objects))


DETECTOR = Capability(
    name="detector",
    meaning="the detector of objects by the first sensor; none when absent.",
    settings=DetectorSettings,
    build=build_recognition,
    # No topic tells a node what a detector sees.
    is_on_board=False,
)
