"""The picture of a path-following run in the browser."""

from typing import TYPE_CHECKING

import numpy as np

from jaxplore.report.drawing.palette import INK, PALE
from jaxplore.report.following.data import PathData, PathFrame
from jaxplore.report.following.plots import FLOOR
from jaxplore.scenes.scene import HEAD_ROOM, Scene
from jaxplore.scenes.shapes import segments, strip

if TYPE_CHECKING:
    import viser

CORRIDOR, COURSE = -0.01, 0.01
"""Heights of the corridor and of the lines of the course [m]."""
MOST_NODES = 4000
"""Greatest number of points of a drawn path."""


class PathScene(Scene):
    """The course, its corridor and the obstacles, and what all tasks show."""

    layers = ("corridor", "course", "rollouts", "plan", "trail", "obstacles")

    def __init__(self, server: "viser.ViserServer", recording: PathData) -> None:
        super().__init__(server)
        self._recording = recording
        stride = -(-len(recording.centre) // MOST_NODES)
        self._centre = recording.centre[::stride].astype(np.float64)
        self._edges = recording.edges[:, ::stride].astype(np.float64)
        drawn = np.concatenate([self._centre, *self._edges])
        self.look_at(drawn[np.isfinite(drawn).all(axis=-1)])

    def draw(self, frame: PathFrame, trail: np.ndarray) -> None:
        """Draw a frame, but for its rollouts."""
        recording = self._recording
        if "course" not in self._nodes:
            self._draw_course()
        self.trail(trail)
        self.plan(frame.plan)
        height = HEAD_ROOM * 2.0 * recording.robot_radius
        self.obstacles("obstacles", frame.corners, recording.obstacle_radii, height)
        self.body(recording.footprint, recording.robot_radius, frame.position, frame.heading)

    def _draw_course(self) -> None:
        dashes = segments(self._centre[None], COURSE)[::2]
        self.lines("course", dashes, PALE, 2.0)
        if not len(self._edges):
            return
        self.lines("corridor", segments(self._edges, COURSE), INK, 2.0)
        # An edge at infinity bounds nothing.
        if np.isfinite(self._edges).all():
            self.mesh("corridor/floor", *strip(self._edges[0], self._edges[1], CORRIDOR), FLOOR)
