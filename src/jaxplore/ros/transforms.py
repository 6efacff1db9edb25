"""Poses by chains of transforms, as tf2 follows them, without ROS.

Frames form a forest: each has one parent, in which its transform places it. A pose of one frame in
another leads over their nearest common ancestor, so `map -> odom -> base_link` and
`base_link -> odom` are chains alike.
"""

import bisect
import math
from typing import Any, NamedTuple

import numpy as np

from jaxplore.ros import messages

KEPT_SECONDS = 10.0
"""How long the transforms of a frame are kept [s]; tf2 has the same time."""
BACK_SECONDS = 1.0
"""Time that a stamp may go back [s]; beyond it a clock has jumped, and a frame begins anew."""
MOST_FRAMES, MOST_KEPT, MOST_LEGS = 1000, 2000, 64
"""Greatest number of frames, of transforms kept of each, and of frames from one to its root."""
MOST_LETTERS = 256
"""Longest name of a frame."""
MOST_TOLD = 8
"""Greatest number of transforms that `gap` lists."""


type _Quaternion = tuple[float, float, float, float]
type _Vector = tuple[float, float, float]


class _Rigid(NamedTuple):
    """A rotation, a unit quaternion (w, x, y, z), and a translation [m].

    Tuples of floats: NumPy takes ten times as long for so few numbers, and they come 200 times a
    second.
    """

    rotation: _Quaternion = (1.0, 0.0, 0.0, 0.0)
    translation: _Vector = (0.0, 0.0, 0.0)

    def then(self, other: "_Rigid") -> "_Rigid":
        """Return the place, in this one's parent, of what `other` places in this one."""
        x, y, z = _rotate(self.rotation, other.translation)
        at_x, at_y, at_z = self.translation
        place = (at_x + x, at_y + y, at_z + z)
        return _Rigid(_product(self.rotation, other.rotation), place)

    @property
    def inverse(self) -> "_Rigid":
        w, x, y, z = self.rotation
        back = (w, -x, -y, -z)
        x, y, z = _rotate(back, self.translation)
        return _Rigid(back, (-x, -y, -z))

    def blend(self, other: "_Rigid", share: float) -> "_Rigid":
        """Return what lies between this one, of share 0, and another one, of share 1."""
        product = sum(a * b for a, b in zip(self.rotation, other.rotation, strict=True))
        # The two signs of a quaternion are one rotation.
        first, second = 1.0 - share, math.copysign(share, product)
        w, x, y, z = (
            first * a + second * b for a, b in zip(self.rotation, other.rotation, strict=True)
        )
        at_x, at_y, at_z = (
            first * a + share * b for a, b in zip(self.translation, other.translation, strict=True)
        )
        return _Rigid(_unit((w, x, y, z)), (at_x, at_y, at_z))


class _Edge:
    """The transforms of a frame in its parent: one for all times, or some in order of time."""

    def __init__(self, parent: str, *, is_static: bool) -> None:
        self.parent, self.is_static = parent, is_static
        self.times: list[float] = []
        self.places: list[_Rigid] = []

    def add(self, time: float, place: _Rigid) -> None:
        if self.is_static or (self.times and time < self.times[-1] - BACK_SECONDS):
            self.times, self.places = [], []
        at = bisect.bisect_left(self.times, time)
        is_known = at < len(self.times) and self.times[at] == time
        self.times[at : at + is_known], self.places[at : at + is_known] = [time], [place]
        old = bisect.bisect_left(self.times, self.times[-1] - KEPT_SECONDS)
        old = max(old, len(self.times) - MOST_KEPT)
        del self.times[:old], self.places[:old]

    def at(self, time: float) -> _Rigid:
        """Interpolate; before the first transform that one holds, after the last that one."""
        after = bisect.bisect_left(self.times, time)
        if after == 0 or after == len(self.times):
            return self.places[min(after, len(self.times) - 1)]
        start, end = self.times[after - 1 : after + 1]
        first, second = self.places[after - 1 : after + 1]
        return first.blend(second, (time - start) / (end - start))


class Transforms:
    """The transforms that have been heard, and the poses that follow from chains of them."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(self, message: Any, *, is_static: bool = False) -> None:
        """Take a `geometry_msgs/TransformStamped`; a static one, of `/tf_static`, is for all times.

        It raises a `ValueError` for numbers that are not finite, a rotation that is no unit
        quaternion, an impossible stamp, a frame that is its own parent or without a name, and too
        many frames.
        """
        parent, child = _name(message.header.frame_id), _name(message.child_frame_id)
        if not 0 < len(parent) <= MOST_LETTERS or not 0 < len(child) <= MOST_LETTERS:
            raise ValueError(
                f"transform has names of {len(parent)} and {len(child)} letters; "
                f"accepted: 1 to {MOST_LETTERS}"
            )
        if parent == child:
            names = messages.text_of(parent)
            raise ValueError(f"transform is of {names!r} in itself; accepted: two frames")
        time, place = messages.time_of(message.header.stamp), _rigid_of(message.transform)
        edge = self._edges.get(child)
        if edge is None and len(self._edges) >= MOST_FRAMES:
            raise ValueError(
                f"transform is of another frame, {messages.text_of(child)!r}; accepted: at most "
                f"{MOST_FRAMES} frames"
            )
        if edge is None or (edge.parent, edge.is_static) != (parent, is_static):
            edge = self._edges[child] = _Edge(parent, is_static=is_static)
        edge.add(time, place)

    def pose(self, parent: str, child: str) -> messages.Odometry | None:
        """Return the newest pose of `child` in `parent` that all transforms between tell.

        Its time is the earliest of the newest stamps of the chain, as of tf2's latest common time;
        the other transforms are interpolated at it. Static ones have no time, and a chain of
        nothing else is of time 0. The yaw is that of the chain in three dimensions. Without a chain
        it returns None. Frames that are each other's parents raise a `ValueError`.
        """
        parent, child = _name(parent), _name(child)
        up, down = self._ancestors(child), self._ancestors(parent)
        common = next((name for name in up if name in down), None)
        if common is None:
            return None
        ends = up[: up.index(common)], down[: down.index(common)]
        moving = [self._edges[name] for end in ends for name in end]
        moving = [edge for edge in moving if not edge.is_static]
        time = min((edge.times[-1] for edge in moving), default=0.0)
        of_child, of_parent = (self._place(end, time) for end in ends)
        found = of_parent.inverse.then(of_child)
        w, x, y, z = found.rotation
        # As `messages.yaw_of`: where the frame's x axis points on the floor.
        yaw = math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
        pose = np.array([*found.translation[:2], yaw])
        return messages.Odometry(time, messages.text_of(parent), pose, None)

    def gap(self, parent: str, child: str) -> str:
        """Return in words why there is no chain between two frames, and what has been heard."""
        heard = [f"{edge.parent} -> {name}" for name, edge in self._edges.items()]
        shown = ", ".join(map(messages.text_of, heard[:MOST_TOLD])) or "none"
        more = ", ..." if len(heard) > MOST_TOLD else ""
        return f"no transforms lead from {_name(parent)} to {_name(child)}; heard: {shown}{more}"

    def _ancestors(self, name: str) -> list[str]:
        """Return a frame, its parent and so on to the root."""
        found = [name]
        while (edge := self._edges.get(found[-1])) is not None:
            if edge.parent in found or len(found) > MOST_LEGS:
                names = " -> ".join(map(messages.text_of, [edge.parent, *found[::-1]][:MOST_TOLD]))
                raise ValueError(f"transforms are {names}; accepted: a tree")
            found.append(edge.parent)
        return found

    def _place(self, names: list[str], time: float) -> _Rigid:
        """Return the place of the first frame in the parent of the last."""
        found = _Rigid()
        for name in names:
            found = self._edges[name].at(time).then(found)
        return found


def _name(frame: object) -> str:
    """Return the name of a frame; tf2 leaves out the leading slash of old ones."""
    return str(frame).removeprefix("/")


def _rigid_of(transform: Any) -> _Rigid:
    place, turn = transform.translation, transform.rotation
    translation = float(place.x), float(place.y), float(place.z)
    if not all(map(math.isfinite, translation)):
        raise ValueError(f"translation is {translation}; accepted: finite numbers")
    messages.yaw_of(turn)
    return _Rigid(_unit((float(turn.w), float(turn.x), float(turn.y), float(turn.z))), translation)


def _unit(rotation: _Quaternion) -> _Quaternion:
    w, x, y, z = rotation
    norm = math.hypot(w, x, y, z)
    return w / norm, x / norm, y / norm, z / norm


def _product(one: _Quaternion, two: _Quaternion) -> _Quaternion:
    w, x, y, z = one
    ow, ox, oy, oz = two
    return (
        w * ow - x * ox - y * oy - z * oz,
        w * ox + x * ow + y * oz - z * oy,
        w * oy - x * oz + y * ow + z * ox,
        w * oz + x * oy - y * ox + z * ow,
    )


def _rotate(rotation: _Quaternion, vector: _Vector) -> _Vector:
    w, x, y, z = rotation
    _, *turned = _product(_product(rotation, (0.0, *vector)), (w, -x, -y, -z))
    x, y, z = turned
    return x, y, z
