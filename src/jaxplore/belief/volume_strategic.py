"""The belief of a volume with what a strategic layer found."""

from typing import ClassVar

import equinox as eqx
from jaxtyping import Array, Float

from jaxplore._types import Scalar
from jaxplore.belief.timed_reference import TimedReference
from jaxplore.belief.volume_belief import VolumeBelief
from jaxplore.maps.volume_field import VolumeField


class VolumeStrategicBelief(VolumeBelief, TimedReference):
    """A belief of a volume with the field and the reference of a strategic layer.

    Args:
        best: greatest information over headings by position [nat m^3], as of the last update of the
            strategic layer.
        reference: (T, 3) reference positions (x, y, z) with z up [m]; row i is due in
            `(i + 1) reference_period - reference_age` seconds.
        reference_period: time between the rows of the reference [s].
        reference_age: time since the reference was made [s].
    """

    best: VolumeField = eqx.field(kw_only=True)
    reference: Float[Array, "T 3"] = eqx.field(kw_only=True)
    reference_period: Scalar = eqx.field(kw_only=True)
    reference_age: Scalar = eqx.field(kw_only=True)

    dimensions: ClassVar[int] = 3
