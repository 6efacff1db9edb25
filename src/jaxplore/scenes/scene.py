"""What all tasks show: the robot, its trail, its plan and its rollouts."""

import abc
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.report.drawing.colours import MOVER, MOVER_EDGE
from jaxplore.report.drawing.palette import PAPER, PLAN, ROBOT, TRAIL, Colour
from jaxplore.scenes.shapes import grow_outlines, prisms, raise_points, segments, turn

if TYPE_CHECKING:
    import viser

# Heights of what lies on the ground, so that nothing hides what is more important [m].
SCAN, TRAILS, ROLLOUTS, REFERENCES, PLANS = 0.01, 0.02, 0.03, 0.04, 0.05
HEAD_ROOM = 0.35
"""Height of the robot and of obstacles, as a share of the robot's length [1]."""


class Scene(abc.ABC):
    """The picture of a run in the browser; abstract. The run may have no step yet.

    A layer is a node of the scene that the page can hide. Its lines and meshes are made when they
    are first drawn, and changed after that.
    """

    layers: tuple[str, ...] = ()
    """Names of the layers, in the order in which the page lists them."""

    def __init__(self, server: "viser.ViserServer") -> None:
        self._server = server
        self._nodes: dict[str, Any] = {}
        self._hidden: set[str] = set()

    @abc.abstractmethod
    def draw(self, frame: Any, trail: np.ndarray) -> None:
        """Draw a frame without its rollouts; the trail (N, 2) is of the run so far [m]."""

    def show(self, layer: str, *, is_shown: bool) -> None:
        """Show or hide a layer."""
        self._hidden = self._hidden - {layer} if is_shown else self._hidden | {layer}
        for name, node in tuple(self._nodes.items()):
            if name.split("/")[0] == layer:
                node.visible = is_shown

    def clear(self) -> None:
        """Remove everything that was drawn."""
        # Children before their parents, which take them along.
        for node in reversed(self._nodes.values()):
            node.remove()
        self._nodes.clear()

    def _is_shown(self, name: str) -> bool:
        return name.split("/")[0] not in self._hidden

    def look_at(self, corners: np.ndarray) -> None:
        """Let pages that open from now on look at the box around points (N, 2) [m] from above."""
        low, high = np.nanmin(corners, axis=0), np.nanmax(corners, axis=0)
        middle, size = 0.5 * (low + high), float(np.max(high - low))
        camera = self._server.initial_camera
        camera.look_at = np.array([*middle, 0.0])
        # Nearly straight down, so that the map is as on paper and heights can still be seen.
        camera.position = np.array([middle[0], middle[1] - 0.25 * size, 0.7 * size])

    def lines(
        self, name: str, pieces: np.ndarray, colour: Colour | np.ndarray, thickness: float
    ) -> None:
        """Draw segments with the ends `pieces` (N, 2, 3) [m].

        The name is a layer, or layer/part. There is one colour for all, or one (N, 2, 3) for each
        end. The thickness is in pixels.
        """
        colours = np.asarray(colour, np.uint8)
        colours = colours[:3] if colours.ndim == 1 else linear_light(colours)
        node = self._nodes.get(name)
        if node is not None and (colours.ndim == 1 or node.points.shape == pieces.shape):
            node.points = pieces
            if colours.ndim > 1:
                node.colors = colours
            return
        # Colours of another number of segments must change together with these.
        self._nodes[name] = self._server.scene.add_line_segments(
            f"/{name}",
            pieces,
            colours,
            thickness=thickness,
            thickness_units="screen",
            visible=self._is_shown(name),
        )

    def mesh(
        self,
        name: str,
        vertices: np.ndarray,
        faces: np.ndarray,
        colour: Colour,
    ) -> Any:
        """Draw a mesh, or move the vertices of the one of that name, and return its node."""
        node = self._nodes.get(name)
        if node is not None and node.vertices.shape == vertices.shape:
            node.vertices = vertices
            return node
        self._nodes[name] = self._server.scene.add_mesh_simple(
            f"/{name}",
            vertices,
            faces,
            color=colour[:3],
            flat_shading=True,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
            visible=self._is_shown(name),
        )
        return self._nodes[name]

    def picture(
        self,
        name: str,
        picture: np.ndarray,
        pose: np.ndarray,
        size: tuple[float, float],
        height: float,
    ) -> None:
        """Lay a picture (rows, columns, 3) on the ground, with row 0 at the low end of y.

        The name is a layer, or layer/part. `pose` is that of the picture's corner [m, m, rad],
        `size` its extents along x and y [m], and `height` the height [m] at which it lies.
        """
        node = self._nodes.get(name)
        if node is not None:
            # Encoding is most of what a view costs.
            if not np.array_equal(node.image, picture):
                node.image = picture
            return
        yaw = float(pose[2])
        cos, sin = np.cos(yaw), np.sin(yaw)
        half = 0.5 * np.asarray(size)
        middle = pose[:2] + np.array([cos * half[0] - sin * half[1], sin * half[0] + cos * half[1]])
        self._nodes[name] = self._server.scene.add_image(
            f"/{name}",
            picture,
            *size,
            format="jpeg",
            jpeg_quality=85,
            cast_shadow=False,
            receive_shadow=False,
            wxyz=turn(yaw),
            position=(float(middle[0]), float(middle[1]), height),
            visible=self._is_shown(name),
        )

    def body(
        self, footprint: np.ndarray, radius: float, position: np.ndarray, heading: float
    ) -> None:
        """Draw the robot with its footprint and an arrow in its heading."""
        outline = footprint if len(footprint) else _disc(radius)
        length = float(np.ptp(outline[:, 0]))
        top = HEAD_ROOM * length
        if "robot" not in self._nodes:
            self.mesh("robot", *prisms(_counterclockwise(outline)[None], 0.0, top), ROBOT)
            front, half = float(outline[:, 0].max()), 0.25 * float(np.ptp(outline[:, 1]))
            back = front - 0.55 * length
            arrow = np.array([[0.85 * front, 0.0], [back, half], [back, -half]])
            faces = np.array([[0, 1, 2]], np.uint32)
            self.mesh("robot/arrow", raise_points(arrow, 1.05 * top), faces, PAPER)
        node = self._nodes["robot"]
        if np.isfinite(position).all():
            node.position = (float(position[0]), float(position[1]), 0.0)
        node.wxyz = turn(heading)
        self._nodes["robot/arrow"].visible = bool(np.isfinite(heading))

    def trail(self, points: np.ndarray) -> None:
        """Draw the positions (N, 2) of the robot so far [m]."""
        if len(points) > 1:
            self.lines("trail", segments(points[None], TRAILS), TRAIL, 2.0)

    def rollouts(self, samples: np.ndarray, colours: np.ndarray) -> None:
        """Draw rollouts (S, T, 2) [m] in their colours (S, 3)."""
        if samples.size and samples.shape[1] > 1:
            each = np.repeat(colours, samples.shape[1] - 1, axis=0)
            ends = np.repeat(each[:, None], 2, axis=1)
            self.lines("rollouts", segments(samples, ROLLOUTS), ends, 1.5)

    def plan(self, points: np.ndarray) -> None:
        """Draw the plan (T, 2) [m]."""
        if len(points) > 1:
            self.lines("plan", segments(points[None], PLANS), PLAN, 4.0)

    def obstacles(self, name: str, corners: np.ndarray, radii: np.ndarray, height: float) -> None:
        """Draw moving obstacles: convex polygons (N, V, 2) grown by radii (N,) [m]."""
        if not len(corners):
            return
        outlines = grow_outlines(corners.astype(np.float64), np.asarray(radii, np.float64))
        self.mesh(name, *prisms(outlines, 0.0, height), MOVER)
        rims = np.concatenate([outlines, outlines[:, :1]], axis=1)
        self.lines(f"{name}/rim", segments(rims, 1.02 * height), MOVER_EDGE, 3.0)

    def ring(self, name: str, middle: np.ndarray, radius: float, colour: Colour) -> None:
        """Draw a flat disc around a point (2,) [m]."""
        self._draw_disc(name, middle, radius, 0.3 * radius, colour)

    def disc(self, name: str, middle: np.ndarray, radius: float, colour: Colour) -> None:
        """Draw a robot that is a disc around a point (2,) [m]."""
        self._draw_disc(name, middle, radius, 2.0 * HEAD_ROOM * radius, colour)

    def _draw_disc(
        self, name: str, middle: np.ndarray, radius: float, height: float, colour: Colour
    ) -> None:
        outline = np.asarray(middle, np.float64) + _disc(radius)
        self.mesh(name, *prisms(outline[None], 0.0, height), colour)


def linear_light(colours: np.ndarray) -> np.ndarray:
    """Return sRGB colours in 256 levels as levels of linear light (IEC 61966-2-1).

    viser takes the colours of the ends of lines as such, and all others as sRGB.
    """
    level = colours / 255.0
    light = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
    return np.asarray((255.0 * light).round(), np.uint8)


def _disc(radius: float) -> np.ndarray:
    return np.asarray(grow_outlines(np.zeros((1, 1, 2)), np.array([radius]))[0])


def _counterclockwise(outline: np.ndarray) -> np.ndarray:
    x, y = outline.T
    area = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    return outline if area > 0.0 else outline[::-1]
