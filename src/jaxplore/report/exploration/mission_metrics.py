"""Metrics of parts, of a robot and of a fleet."""

import dataclasses

from jaxplore.report.of_parts import PartsMetrics


@dataclasses.dataclass(frozen=True, kw_only=True)
class MissionMetrics(PartsMetrics):
    """Metrics of the parts of the robots, one of which may say when the task is finished."""

    @property
    def ends_by_parts(self) -> bool:
        """Whether a part says when the task is finished."""
        return any(each.is_end for each in self.parts.values())
