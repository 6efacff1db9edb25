"""Settings of injected faults."""

from jaxplore.parts.capability import Built, Capability, Surroundings
from jaxplore.parts.faults.truth import Faults
from jaxplore.settings.defaults import arguments, setting
from jaxplore.settings.sections import Delay, Interval, Real, Section, Wait


class FaultSettings(Section):
    """Injected faults: see `jaxplore.Faults`."""

    scan_dropout: Interval = setting(Faults, "scan_dropout")
    lost_odometry: Interval = setting(Faults, "lost_odometry")
    frozen_odometry: Interval = setting(Faults, "frozen_odometry")
    control_delay: Delay = setting(Faults, "control_delay")
    carried_at: Wait | None = setting(Faults, "carried_at")
    carried_to: tuple[Real, Real, Real] | None = setting(Faults, "carried_to")


def build_faults(given: FaultSettings, around: Surroundings) -> Built:
    """Build the injected faults; none at all by default, which leaves them out of the program."""
    injected = arguments(given, Faults)
    if injected == arguments(FaultSettings(), Faults):
        return Built()
    if given.carried_to is not None:
        injected["carried_to"] = around.datum.to_local(given.carried_to)
    return Built(disturbance=Faults(**injected))


FAULTS = Capability(
    name="faults",
    meaning="injected faults.",
    settings=FaultSettings,
    build=build_faults,
    dimensions=None,
    is_optional=False,
    is_on_board=False,
)
