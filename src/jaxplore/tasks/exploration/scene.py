"""The picture of an exploration run in the browser."""

from typing import TYPE_CHECKING

import numpy as np

from jaxplore.report.drawing.colours import FREE, TARGET, blend
from jaxplore.report.drawing.palette import LIDAR_RAY, REFERENCE
from jaxplore.report.exploration.data import ExplorationData, ExplorationFrame
from jaxplore.scenes.scene import HEAD_ROOM, REFERENCES, SCAN, Scene
from jaxplore.scenes.shapes import segments
from jaxplore.scenes.textures import Ground

if TYPE_CHECKING:
    import viser

MOST_RAYS = 90
RAY = blend(LIDAR_RAY, FREE, 0.6)
"""Colour of a beam: lines of the page have no opacity."""


class ExplorationScene(Scene):
    """The belief, the information, the scan, and what all tasks show.

    It reads nothing of the true world, which a robot does not know.
    """

    layers = (
        "belief",
        "information",
        "scan",
        "rollouts",
        "plan",
        "reference",
        "trail",
        "obstacles",
        "targets",
    )

    def __init__(self, server: "viser.ViserServer", recording: ExplorationData) -> None:
        super().__init__(server)
        self._recording = recording
        self._found: np.ndarray | None = None
        self._known: list[tuple[float, ...]] = []
        rows, columns = recording.frames[0].probability.shape
        self._ground = Ground(
            (rows, columns),
            recording.origin,
            recording.resolution,
            recording.field_origin,
            recording.field_resolution,
        )
        self._size = columns * recording.resolution, rows * recording.resolution
        yaw = float(recording.origin[2])
        turned = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]) * self._size
        self.look_at(corners @ turned + recording.origin[:2])

    def draw(self, frame: ExplorationFrame, trail: np.ndarray) -> None:
        """Draw a frame, but for its rollouts."""
        recording = self._recording
        names = recording.state_names
        here = frame.state[[names.index("x"), names.index("y")]].astype(np.float64)
        self._draw_ground(frame)
        self._draw_scan(frame, here)
        self.trail(trail)
        self.plan(frame.plan)
        if len(frame.reference) > 1:
            pieces = segments(frame.reference[None], REFERENCES)
            self.lines("reference", pieces, REFERENCE, 3.0)
        radii = recording.mover_radii
        if len(radii):
            height = HEAD_ROOM * 2.0 * recording.robot_radius
            self.obstacles("obstacles", frame.movers[:, None], radii, height)
        self._draw_targets(frame)
        self._draw_objects(frame)
        self.body(recording.footprint, recording.robot_radius, here, frame.heading)

    def _draw_ground(self, frame: ExplorationFrame) -> None:
        information = frame.information if self._is_shown("information") else None
        picture = self._ground.picture(frame.probability, information)
        self.picture("belief", picture, self._recording.origin, self._size, 0.0)

    def _draw_scan(self, frame: ExplorationFrame, here: np.ndarray) -> None:
        ends = frame.scan[:: max(1, len(frame.scan) // MOST_RAYS)]
        if len(ends):
            starts = np.broadcast_to(here, ends.shape)
            self.lines("scan", segments(np.stack([starts, ends], axis=1), SCAN), RAY, 1.0)

    def _draw_targets(self, frame: ExplorationFrame) -> None:
        recording = self._recording
        if recording.goal is not None and "targets/goal" not in self._nodes:
            self.ring("targets/goal", recording.goal, recording.robot_radius, REFERENCE)
        if self._found is not None and np.array_equal(self._found, frame.is_found):
            return
        self._found = np.array(frame.is_found)
        radius = 0.8 * recording.robot_radius
        for index, (place, is_found) in enumerate(
            zip(recording.targets, frame.is_found, strict=True)
        ):
            # A target that was found is a pale disc.
            colour = blend(TARGET, FREE, 0.3) if is_found else TARGET
            name = f"targets/{index}"
            if name in self._nodes:
                self._nodes.pop(name).remove()
            self.ring(name, place, radius, colour)

    def _draw_objects(self, frame: ExplorationFrame) -> None:
        """Draw a disc for each place that parts of the robot mark."""
        parts = self._recording.parts.values()
        known = [mark for each in parts for mark in each.marks(frame)]
        shown = [(*place.tolist(), *colour) for place, colour in known]
        if shown == self._known:
            return
        self._known = shown
        for name in [each for each in self._nodes if each.startswith("objects/")]:
            self._nodes.pop(name).remove()
        for index, (place, colour) in enumerate(known):
            self.ring(f"objects/{index}", place, 0.6 * self._recording.robot_radius, colour)

    def clear(self) -> None:
        """Remove everything that was drawn."""
        super().clear()
        self._found = None
        self._known = []
