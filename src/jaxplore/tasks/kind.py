"""What is told of a kind of task."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from jaxplore.maps.datum import Datum
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.scenes.picture import PictureScene
from jaxplore.scenes.scene import Scene
from jaxplore.settings.sections import RunSettings, check_section
from jaxplore.simulation.experiment import Experiment
from jaxplore.tasks.memory import Part, estimate_programs
from jaxplore.topics.content import Content

type Entries = Mapping[str, Any]
"""Settings as in a settings file."""


class Shown(NamedTuple):
    """How recordings of a class are shown.

    Args:
        recording: class of the recordings.
        scene: their scene in the browser, made of a server and a recording.
        content: what is written of them to a recording for Foxglove.
        is_relative: whether the scene is drawn relative to a place near the first of the
            `positions`: pages draw in single precision.
    """

    recording: type
    scene: Callable[[Any, Any], Scene] = PictureScene
    content: type[Content] = Content
    is_relative: bool = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class OnMaps:
    """How runs of a kind are compared on several maps, volumes or paths.

    Args:
        files: the files in words, such as "ROS map".
        accepted: what makes a file one of them, in words.
        is_file: function that says whether a file of a folder is one of them.
        read: function that reads a file, for a hash of its content; each part is one of bytes.
        plan: function of settings that returns the true map as seen from above, and the datum to
            which it is relative.
        names: names of generated ones; each is the value of the kind's `selector`.
        packed: name of the file in what `pack` returns; its own when absent.
        pack: function that reads a file, to send it to another machine: content by name of a file.
        build: function that builds the experiment of settings, with the rows and columns of the
            arrays of the map, which similar maps share; None if the run chooses them.
        variants: architectures that are compared by default.
        with_protocol: function that merges entries over the defaults of a comparison.
        shared: sections that all variants share, so that they are comparable.
        start: names of the components of a start.
    """

    files: str
    accepted: str
    is_file: Callable[[Path], bool]
    read: Callable[[str], tuple[bytes | None, ...]]
    plan: Callable[[Any], tuple[OccupancyGrid, Datum]]
    build: Callable[[Any, tuple[int, int] | None], Experiment]
    names: tuple[str, ...] = ()
    packed: str | None = None
    pack: Callable[[str], dict[str, bytes]] | None = None
    variants: tuple[str, ...] = ()
    with_protocol: Callable[[Entries], dict[str, Any]] = dict
    shared: tuple[str, ...] = ("robot",)
    start: tuple[str, ...] = ("x", "y", "yaw")

    def pack_file(self, path: str) -> dict[str, bytes]:
        """Return the content of a file and of those that belong to it, by name."""
        if self.pack is not None:
            return self.pack(path)
        return {Path(path).name: self.read(path)[0] or b""}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of task. All that the commands, the pages and the monitors know of it stands here.

    Args:
        name: name of the kind.
        title: heading in the page of settings.
        place: where its robot moves, in messages, such as "in a volume".
        selector: setting that names the map, path or volume. Entries with it are of this kind.
        settings: class of its settings.
        build: function that builds the experiment of settings.
        check: function that checks entries and fills in defaults; that of the class when absent.
        needs: function that estimates the memory of a run, part by part, from its settings and the
            memory [bytes] that there is; that of the programs when absent.
        places: names that stand for whole runs, and the entries of each.
        words: names that stand for the kind or for a part of it. A settings file may say where the
            run takes place, and the entries of the word are its defaults.
        suffixes: ends of the names of files that are of this kind.
        files: these files in words.
        read: function of the name of a file, and whether it may name code, that returns the entries
            of a run there; the file is the value of the `selector` when absent.
        architectures: function of entries that returns what is compared by default.
        with_start: function that adds a start to entries where the map has none.
        shown: how its recordings are shown; by the pictures of its animation when absent.
        on_maps: how its runs are compared on several maps; they are not when absent.
    """

    name: str
    title: str
    place: str
    selector: str
    settings: type[RunSettings]
    build: Callable[[Any], Experiment]
    check: Callable[[dict[str, Any]], RunSettings] | None = None
    needs: Callable[[Any, float], tuple[Part, ...]] = lambda *_: (estimate_programs(),)
    places: Mapping[str, Entries] = dataclasses.field(default_factory=dict)
    words: Mapping[str, Entries] = dataclasses.field(default_factory=dict)
    suffixes: tuple[str, ...] = ()
    files: str = ""
    read: Callable[[str, bool], Entries] | None = None
    architectures: Callable[[dict[str, Any]], tuple[str, ...]] = lambda _: ()
    with_start: Callable[[dict[str, Any]], dict[str, Any]] = lambda entries: entries
    shown: tuple[Shown, ...] = ()
    on_maps: OnMaps | None = None

    def make_settings(self, entries: dict[str, Any]) -> RunSettings:
        """Check entries, and fill in defaults.

        The `ValueError` names an unknown name or a value that is not accepted.
        """
        return check_section(self.settings, entries) if self.check is None else self.check(entries)

    def read_entries(self, file: str, *, is_trusted: bool = False) -> dict[str, Any]:
        """Return the entries of a run in a file."""
        if self.read is not None:
            return dict(self.read(file, is_trusted))
        return {self.selector: str(Path(file).absolute())}
