"""The kind of task in which a robot follows a path."""

from jaxplore.report.following.data import PathData
from jaxplore.tasks.kind import Kind, Shown
from jaxplore.tasks.memory import Part, estimate_programs, estimate_record, estimate_rollouts
from jaxplore.tasks.path.build import build_path_following
from jaxplore.tasks.path.on_maps import ALONG_PATHS
from jaxplore.tasks.path.scene import PathScene
from jaxplore.tasks.path.settings import (
    PATH,
    TRACK,
    PathFollowingSettings,
    PathSettings,
    make_path_settings,
)
from jaxplore.tasks.path.topics import PathContent


def estimate_path_following(settings: PathSettings, _: float) -> tuple[Part, ...]:
    """Estimate the memory of a run, part by part: see `jaxplore.tasks.memory`."""
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


# The generated track is only a default: a settings file may name a path.
PATH_FOLLOWING = Kind(
    name="path",
    title="Path following",
    place="along a path",
    selector=PATH,
    settings=PathFollowingSettings,
    check=make_path_settings,
    build=build_path_following,
    needs=estimate_path_following,
    places={PATH: {PATH: TRACK}},
    words={PATH: {PATH: TRACK}},
    on_maps=ALONG_PATHS,
    shown=(Shown(PathData, PathScene, PathContent, is_relative=True),),
)
