"""The pictures of explorations in the browser, of one robot and of a fleet."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.report.drawing.colours import FREE, TARGET, blend
from jaxplore.report.drawing.palette import LIDAR_RAY, PAPER, REFERENCE
from jaxplore.report.exploration.data import ExplorationData, ExplorationFrame
from jaxplore.report.exploration.mission import MissionData, MissionFrame
from jaxplore.report.fleet.animation import LINK, robot_colour
from jaxplore.report.fleet.data import FleetData, FleetFrame
from jaxplore.scenes.scene import HEAD_ROOM, PLANS, REFERENCES, SCAN, TRAILS, Scene
from jaxplore.scenes.shapes import segments
from jaxplore.scenes.textures import Ground

if TYPE_CHECKING:
    import viser

MOST_RAYS = 90
MOST_POINTS = 2000
"""Greatest number of points of the trail of a robot of a fleet."""
RAY = blend(LIDAR_RAY, FREE, 0.6)
"""Colour of a beam: lines of the page have no opacity."""


class MapScene(Scene):
    """What runs on a map show, of one robot or of several: the belief, targets and marks of parts.

    It reads nothing of the true world, which a robot does not know. `field_origin` [m, m, rad] and
    `spacing` [m] are those of the information field.
    """

    def __init__(
        self,
        server: "viser.ViserServer",
        recording: MissionData,
        field_origin: np.ndarray,
        spacing: float,
    ) -> None:
        super().__init__(server)
        self._recording: Any = recording
        self._found: np.ndarray | None = None
        self._known: list[tuple[float, ...]] = []
        rows, columns = recording.frames[0].probability.shape
        shape, side = (rows, columns), recording.resolution
        self._ground = Ground(shape, recording.origin, side, field_origin, spacing)
        self._size = columns * side, rows * side
        yaw = float(recording.origin[2])
        turned = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]) * self._size
        self.look_at(corners @ turned + recording.origin[:2])

    def draw_ground(self, probability: np.ndarray, information: np.ndarray | None = None) -> None:
        """Draw the belief (H, W) in 256 levels, and the information of scans if it is given."""
        picture = self._ground.picture(probability, information)
        self.picture("belief", picture, self._recording.origin, self._size, 0.0)

    def draw_targets(self, frame: MissionFrame, radius: float) -> None:
        """Draw the goal and the targets, as discs for a robot of a radius [m]."""
        goal = self._recording.goal
        if goal is not None and "targets/goal" not in self._nodes:
            self.ring("targets/goal", goal, radius, REFERENCE)
        if self._found is not None and np.array_equal(self._found, frame.is_found):
            return
        self._found = np.array(frame.is_found)
        targets = self._recording.targets
        for index, (place, is_found) in enumerate(zip(targets, frame.is_found, strict=True)):
            # A target that was found is a pale disc.
            colour = blend(TARGET, FREE, 0.3) if is_found else TARGET
            name = f"targets/{index}"
            if name in self._nodes:
                self._nodes.pop(name).remove()
            self.ring(name, place, 0.8 * radius, colour)

    def draw_marks(self, frame: MissionFrame, radius: float) -> None:
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
            self.ring(f"objects/{index}", place, 0.6 * radius, colour)

    def clear(self) -> None:
        """Remove everything that was drawn."""
        super().clear()
        self._found = None
        self._known = []


class ExplorationScene(MapScene):
    """The belief, the information, the scan, and what all tasks show."""

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
        super().__init__(server, recording, recording.field_origin, recording.field_resolution)

    def draw(self, frame: ExplorationFrame, trail: np.ndarray) -> None:
        """Draw a frame, but for its rollouts."""
        recording = self._recording
        names = recording.state_names
        here = frame.state[[names.index("x"), names.index("y")]].astype(np.float64)
        is_shown = self._is_shown("information")
        self.draw_ground(frame.probability, frame.information if is_shown else None)
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
        self.draw_targets(frame, recording.robot_radius)
        self.draw_marks(frame, recording.robot_radius)
        self.body(recording.footprint, recording.robot_radius, here, frame.heading)

    def _draw_scan(self, frame: ExplorationFrame, here: np.ndarray) -> None:
        ends = frame.scan[:: max(1, len(frame.scan) // MOST_RAYS)]
        if len(ends):
            starts = np.broadcast_to(here, ends.shape)
            self.lines("scan", segments(np.stack([starts, ends], axis=1), SCAN), RAY, 1.0)


class FleetScene(MapScene):
    """What the robots of a fleet know together, and each in its colour, with its way and plan."""

    layers = ("belief", "robots", "trail", "plan", "links", "targets")

    def __init__(self, server: "viser.ViserServer", recording: FleetData) -> None:
        super().__init__(server, recording, recording.origin, recording.resolution)
        # Places of the robots in the frames so far: a run that goes on has no steps yet.
        self._places: dict[int, np.ndarray] = {}

    def draw(self, frame: FleetFrame, trail: np.ndarray) -> None:
        """Draw a frame; the trail, of the first robot, is drawn with those of the others."""
        recording = self._recording
        self._places[frame.step] = frame.positions
        self.draw_ground(frame.probability)
        for number, way in enumerate(self._ways(frame.step)):
            colour = robot_colour(number)
            if len(way) > 1:
                self.lines(f"trail/{number}", segments(way[None], TRAILS), colour, 2.0)
            plan = frame.plans[number]
            if len(plan) > 1:
                self.lines(f"plan/{number}", segments(plan[None], PLANS), colour, 4.0)
            radius = float(recording.radii[number])
            self.disc(f"robots/{number}", frame.positions[number], radius, colour)
            ahead = np.array([np.cos(frame.headings[number]), np.sin(frame.headings[number])])
            nose = np.stack([frame.positions[number], frame.positions[number] + radius * ahead])
            top = 2.1 * HEAD_ROOM * radius
            self.lines(f"robots/{number}/nose", segments(nose[None], top), PAPER, 3.0)
        # Of all pairs, so that the number of lines stays the same.
        first, second = np.triu_indices(recording.num_robots, 1)
        pairs = np.stack([frame.positions[first], frame.positions[second]], axis=1)
        heard = np.where(frame.links[first, second][:, None, None], pairs, np.nan)
        if len(heard):
            self.lines("links", segments(heard, REFERENCES), LINK, 1.5)
        radius = float(np.max(recording.radii))
        self.draw_targets(frame, radius)
        self.draw_marks(frame, radius)

    def _ways(self, step: int) -> np.ndarray:
        """Return the ways (N, T, 2) of the robots up to a step [m]."""
        recording = self._recording
        if recording.num_steps:
            ways = recording.trails[:, : step + 1]
            kept = np.unique(np.linspace(0, ways.shape[1] - 1, MOST_POINTS).round().astype(int))
            return np.asarray(ways[:, kept])
        places = [each for at, each in sorted(self._places.items()) if at <= step]
        return np.stack(places, axis=1)

    def clear(self) -> None:
        """Remove everything that was drawn."""
        super().clear()
        self._places = {}
