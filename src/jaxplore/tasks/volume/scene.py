"""The picture of an exploration of a volume in the browser, which can be turned."""

from typing import TYPE_CHECKING

import numpy as np

from jaxplore.report.drawing.palette import PLAN, REFERENCE, ROBOT, TRAIL, Colour
from jaxplore.report.volume.data import VolumeData, VolumeFrame
from jaxplore.report.volume.space import height_colours, surface
from jaxplore.scenes.scene import Scene

if TYPE_CHECKING:
    import viser


class VolumeScene(Scene):
    """The voxels that the robot has found to be occupied, its trail and its plan, in space."""

    layers = ("voxels", "plan", "trail", "goal", "marks")

    def __init__(self, server: "viser.ViserServer", recording: VolumeData) -> None:
        super().__init__(server)
        self._recording = recording
        self._drawn: np.ndarray | None = None
        self._marked: list[tuple[float, ...]] = []
        shape = np.array(recording.world.shape[::-1])
        self._low = np.asarray(recording.origin, np.float64)
        self._high = self._low + shape * recording.resolution
        # From obliquely above, so that heights can be seen.
        middle, size = 0.5 * (self._low + self._high), float((self._high - self._low).max())
        server.initial_camera.look_at = middle
        server.initial_camera.position = middle + size * np.array([-0.35, -0.8, 0.8])

    def draw(self, frame: VolumeFrame, trail: np.ndarray) -> None:
        """Draw a frame."""
        if self._drawn is None or not np.array_equal(self._drawn, frame.voxels):
            self._draw_voxels(frame)
        self._line("trail", trail, TRAIL, 2.0)
        self._line("plan", frame.plan, PLAN, 4.0)
        self._draw_goal()
        self._draw_marks(frame)
        self._draw_robot(frame)

    def clear(self) -> None:
        """Remove everything that was drawn."""
        super().clear()
        self._drawn, self._marked = None, []

    def _draw_voxels(self, frame: VolumeFrame) -> None:
        self._drawn = np.array(frame.voxels)
        side = self._recording.resolution
        voxels = surface(frame.find_occupied(self._recording.world.shape))
        points = self._low + (voxels[:, ::-1] + 0.5) * side
        if "voxels" in self._nodes:
            self._nodes.pop("voxels").remove()
        if len(points):
            self._nodes["voxels"] = self._server.scene.add_point_cloud(
                "/voxels",
                points.astype(np.float32),
                height_colours(points[:, 2], self._low[2], self._high[2]),
                point_size=side,
                point_shape="square",
                precision="float32",
                visible=self._is_shown("voxels"),
            )

    def _draw_goal(self) -> None:
        if self._recording.goal is None or "goal" in self._nodes:
            return
        self._nodes["goal"] = self._server.scene.add_icosphere(
            "/goal",
            radius=self._recording.robot_radius,
            color=REFERENCE[:3],
            position=tuple(self._recording.goal.tolist()),
            visible=self._is_shown("goal"),
        )

    def _draw_marks(self, frame: VolumeFrame) -> None:
        marks = self._recording.marks(frame)
        shown = [(*place.tolist(), *colour) for place, colour in marks]
        if shown == self._marked:
            return
        self._marked = shown
        for name in [each for each in self._nodes if each.startswith("marks/")]:
            self._nodes.pop(name).remove()
        for number, (place, colour) in enumerate(marks):
            name = f"marks/{number}"
            self._nodes[name] = self._server.scene.add_icosphere(
                f"/{name}",
                radius=self._recording.robot_radius,
                color=colour[:3],
                position=tuple(place.tolist()),
                visible=self._is_shown(name),
            )

    def _draw_robot(self, frame: VolumeFrame) -> None:
        names = self._recording.state_names
        x, y, z = (float(frame.state[names.index(name)]) for name in "xyz")
        if not np.isfinite([x, y, z]).all():
            return
        if "robot" not in self._nodes:
            self._nodes["robot"] = self._server.scene.add_icosphere(
                "/robot", radius=self._recording.robot_radius, color=ROBOT[:3]
            )
        self._nodes["robot"].position = (x, y, -z)

    def _line(self, name: str, points: np.ndarray, colour: Colour, thickness: float) -> None:
        if len(points) > 1 and np.isfinite(points).all():
            pieces = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
            self.lines(name, pieces, colour, thickness)
