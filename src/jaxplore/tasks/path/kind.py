"""The kind of task in which a robot follows a path."""

from jaxplore.report.following.data import PathData
from jaxplore.tasks.kind import Kind, Shown
from jaxplore.tasks.path.build import build_path_following
from jaxplore.tasks.path.memory import estimate_path_following
from jaxplore.tasks.path.on_maps import ALONG_PATHS
from jaxplore.tasks.path.scene import PathScene
from jaxplore.tasks.path.settings import PATH, TRACK, PathFollowingSettings, make_path_settings
from jaxplore.tasks.path.topics import PathContent

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
