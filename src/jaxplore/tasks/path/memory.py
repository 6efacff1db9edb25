"""The memory of a path-following run, estimated: see `jaxplore.tasks.memory`."""

from jaxplore.tasks.memory import Part, estimate_programs, estimate_record, estimate_rollouts
from jaxplore.tasks.path.settings import PathSettings


def estimate_path_following(settings: PathSettings, _: float) -> tuple[Part, ...]:
    """Estimate the memory of a run, part by part."""
    given, obstacles = settings.controller, settings.obstacles
    corners = len(obstacles.discs) + sum(map(len, obstacles.polygons))
    outcomes = 1 if given.risk_level is None else given.num_outcomes
    number = obstacles.number + corners
    rollouts = estimate_rollouts(
        "controller", settings.robot, given, progress=1, hindrances=number * outcomes
    )
    recorded = estimate_record(
        "time_limit, control_rate", settings.time_limit * settings.control_rate
    )
    return estimate_programs(), rollouts, recorded
