"""A session on a robot: what it knows, kept in a folder, so that it goes on after a restart."""

import dataclasses
import datetime
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxplore._files import parse_json, read_bytes, replace_files
from jaxplore._text import error_reason, printable_path, short_repr
from jaxplore._version import __version__
from jaxplore._xla import on_device
from jaxplore.localisation.localiser import LocaliserState
from jaxplore.maps.datum import FARTHEST
from jaxplore.maps.files.npz import MALFORMED_NPZ, read_arrays
from jaxplore.robot.localisation import PoseKnowledge
from jaxplore.robot.robot import RobotState

FILE = "session.npz"
"""File of a session in its folder."""
PLACE = "place.json"
"""File with the place where the robot was last, which is written more often."""
FORMAT = 1
"""Number of the format of the file."""
SAVE_SECONDS, PLACE_SECONDS = 30.0, 1.0
"""Time between two writings of each [s]."""
FILE_LIMIT = 2**29
"""Largest file that is read [bytes]."""
MOST_HEADER = 2**20
"""Greatest length of its header [bytes]."""
MOST_PLACE = 2_000
"""Largest file of a place that is read [bytes]."""
_HEADER = "header"


class Kept(NamedTuple):
    """What a session keeps of a robot.

    Args:
        arrays: what the robot knows, by name: its map, the time that it spent at places, what its
            parts know, and its stored scans and closed loops if it finds its pose.
        offset: (2,) position of the origin of the belief in the frame of the map [m].
        home: (2,) position to which it returns, relative to that origin [m].
    """

    arrays: Mapping[str, Any]
    offset: np.ndarray
    home: np.ndarray


class LastPlace(NamedTuple):
    """Where a robot was when it was seen last.

    Args:
        pose: (3,) pose of the lidar, relative to the origin of the belief [m, m, rad].
        transform: (3,) pose of the frame of the odometry in that of the map [m, m, rad].
    """

    pose: np.ndarray
    transform: np.ndarray


def name_arrays(own: RobotState) -> dict[str, Any]:
    """Return the arrays of what a robot knows that cannot be derived from other ones, by name.

    Fields follow from the map. What moves is somewhere else after a restart. Surfaces are made from
    the stored scans.
    """
    belief = own.belief
    tree: dict[str, Any] = {
        "map": belief.grid.probability,
        "dwell": belief.dwell,
        "gain": belief.gain,
        "parts": dict(belief.parts),
    }
    if own.place is not None and isinstance(own.place.known, LocaliserState):
        tree["place"] = own.place.known._replace(surface=None)  # type: ignore[arg-type]
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="/"): leaf for path, leaf in leaves}


def with_arrays(own: RobotState, arrays: Mapping[str, np.ndarray]) -> RobotState:
    """Return what a robot knows, with the arrays of `name_arrays` but the map."""
    belief = own.belief
    tree: dict[str, Any] = {"dwell": belief.dwell, "gain": belief.gain, "parts": dict(belief.parts)}
    surface = None
    if own.place is not None and isinstance(own.place.known, LocaliserState):
        surface = own.place.known.surface
        tree["place"] = own.place.known._replace(surface=None)  # type: ignore[arg-type]

    def replace(path: Any, _: Any) -> jax.Array:
        name = jax.tree_util.keystr(path, simple=True, separator="/")
        return on_device(arrays[name])

    kept = jax.tree_util.tree_map_with_path(replace, tree)
    known = belief.with_parts(kept["parts"])
    known = dataclasses.replace(known, dwell=kept["dwell"], gain=kept["gain"])
    own = own._replace(belief=known)
    if surface is not None:
        assert own.place is not None
        place = PoseKnowledge(kept["place"]._replace(surface=surface), own.place.spreads)
        own = own._replace(place=place)
    return own


class Session:
    """The folder of a session: its file is written whole or not at all.

    Args:
        folder: the folder; it is made when the file is written.
        facts: settings that a robot must share with the session to go on with it, by name.
        settings: all settings entries, which the file keeps.

    Attributes:
        kept: what the file has; None without one.
        place: where the robot was last; None if nothing tells it.
        saved_at: time of the last writing by this process, in words; empty before.

    Raises:
        ValueError: a file that cannot be read, of another version, or of other settings.
    """

    def __init__(
        self, folder: Path, facts: Mapping[str, object], settings: Mapping[str, object]
    ) -> None:
        self.folder, self._facts, self._settings = folder, dict(facts), dict(settings)
        self.saved_at = ""
        self.kept: Kept | None = None
        self.place: LastPlace | None = None
        found = _read(folder)
        if found is not None:
            header, arrays = found
            self._check_facts(header)
            path = folder / FILE
            self.kept = Kept(arrays, *(_vector(path, header, name, 2) for name in Kept._fields[1:]))
            self.place = _read_place(folder / PLACE)

    @property
    def is_written(self) -> bool:
        """Whether the folder has a map of this session."""
        return self.kept is not None or bool(self.saved_at)

    def _check_facts(self, header: Mapping[str, Any]) -> None:
        known = header["facts"]
        for name in sorted({*self._facts, *known}):
            given = json.loads(json.dumps(self._facts.get(name)))
            if given != known.get(name):
                raise ValueError(
                    f"session {printable_path(self.folder)} was begun with {name} "
                    f"{short_repr(known.get(name))}, and now it is {short_repr(given)}; accepted: "
                    "the same, or another folder"
                )

    def check(self, own: RobotState) -> None:
        """Check that a robot can take what is kept; a `ValueError` names what differs."""
        assert self.kept is not None
        wanted = {name: _kind(leaf) for name, leaf in name_arrays(own).items()}
        given = {name: _kind(leaf) for name, leaf in self.kept.arrays.items()}
        for name in sorted({*wanted, *given}):
            if wanted.get(name) != given.get(name):
                told = (short_repr(each.get(name, "nothing")) for each in (given, wanted))
                one, other = told
                raise ValueError(
                    f"session {printable_path(self.folder)} has {one} for {short_repr(name)}, and "
                    f"these settings {other}; accepted: the settings of the session, or another "
                    "folder"
                )
        if not _is_sound(self.kept.arrays):
            raise ValueError(
                f"{printable_path(self.folder / FILE)} is damaged; accepted: another folder"
            )

    def write(self, kept: Kept) -> None:
        """Write the file, in place of the one before it.

        Raises:
            OSError: it cannot be written; the former file stays.
        """
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        header = {
            "format": FORMAT,
            "version": __version__,
            "saved_at": now,
            "facts": self._facts,
            "settings": self._settings,
            "offset": kept.offset.tolist(),
            "home": kept.home.tolist(),
        }
        arrays = {f"known/{name}": np.asarray(leaf) for name, leaf in kept.arrays.items()}
        text = np.frombuffer(json.dumps(header).encode(), np.uint8)
        file = io.BytesIO()
        np.savez_compressed(file, allow_pickle=False, **{_HEADER: text}, **arrays)
        replace_files([(self.folder / FILE, file.getvalue())])
        self.saved_at = now

    def write_place(self, place: LastPlace) -> None:
        """Write where the robot is, in place of where it was; errors are those of `write`."""
        text = json.dumps({name: each.tolist() for name, each in place._asdict().items()})
        replace_files([(self.folder / PLACE, text.encode())])


def read_session_settings(folder: Path) -> dict[str, Any] | None:
    """Return the settings entries of a session; None without a file.

    A file that cannot be read, or of another version, is a `ValueError`.
    """
    found = _read(folder)
    return None if found is None else found[0]["settings"]


def _read(folder: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
    """Return the header and the arrays of the file of a session; None without a file."""
    path = folder / FILE
    if not path.exists():
        return None
    where = printable_path(path)
    data = read_bytes(path, "a session", FILE_LIMIT)
    left = [FILE_LIMIT * 4]

    def check(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        size = dtype.itemsize * int(np.prod(shape, dtype=object))
        left[0] -= size
        if left[0] < 0 or (name == _HEADER and size > MOST_HEADER):
            raise ValueError(f"{short_repr(name)} is too large")

    try:
        packed = read_arrays(data, check)
        header = parse_json(packed.pop(_HEADER).tobytes(), MOST_HEADER)
        version = header["format"], header["version"]
        is_right = all(isinstance(header[name], dict) for name in ("facts", "settings"))
    except MALFORMED_NPZ as error:
        raise ValueError(
            f"{where} is no session: {error_reason(error)}; accepted: a folder that jaxplore node "
            "--session has written, or another one"
        ) from None
    if version != (FORMAT, __version__):
        told = short_repr(version[1])
        raise ValueError(
            f"{where} is of version {told} of jaxplore, format {short_repr(version[0])}; accepted: "
            f"{__version__!r}, format {FORMAT}, or another folder"
        )
    if not is_right:
        raise ValueError(f"{where} is no session: its header is damaged; accepted: another folder")
    return header, {name.removeprefix("known/"): each for name, each in packed.items()}


def _read_place(path: Path) -> LastPlace | None:
    """Return where a robot was last; None without a file."""
    if not path.exists():
        return None
    try:
        told = parse_json(read_bytes(path, "a place", MOST_PLACE))
    except ValueError as error:
        raise ValueError(
            f"{printable_path(path)} is no place: {error_reason(error)}; accepted: a file of "
            "jaxplore node --session, or none"
        ) from None
    return LastPlace(*(_vector(path, told, name, 3) for name in LastPlace._fields))


def _vector(path: Path, told: Any, name: str, size: int) -> np.ndarray:
    """Return a place of a file, (size,)."""
    given = told.get(name) if isinstance(told, dict) else None
    try:
        place = np.asarray(given, np.float64)
    except MALFORMED_NPZ:
        place = np.zeros(0)
    if place.shape != (size,) or not (np.abs(place) <= FARTHEST).all():
        raise ValueError(
            f"{printable_path(path)} has {short_repr(given)} for its {name}; accepted: {size} "
            f"numbers up to {FARTHEST:g}"
        )
    return place


def _is_sound(arrays: Mapping[str, np.ndarray]) -> bool:
    """Check the numbers that loops and indices follow, and the probabilities of the map."""
    # The negated comparison also refuses NaN.
    if not bool(((arrays["map"] >= 0.0) & (arrays["map"] <= 1.0)).all()):
        return False
    if "place/scans/number" not in arrays:
        return True
    number, capacity = int(arrays["place/scans/number"]), len(arrays["place/scans/way"])
    loops, pairs = int(arrays["place/closures/number"]), arrays["place/closures/pairs"]
    examined = int(arrays["place/closures/examined"])
    poses = arrays["place/scans/poses"]
    return bool(
        0 <= examined <= number <= capacity
        and 0 <= loops <= len(pairs)
        and ((pairs[:loops] >= 0) & (pairs[:loops] < number)).all()
        and np.isfinite(poses).all()
    )


def _kind(leaf: Any) -> str:
    return f"{leaf.dtype} {list(leaf.shape)}"
