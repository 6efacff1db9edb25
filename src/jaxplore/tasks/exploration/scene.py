"""The pictures of explorations in the browser, of one robot and of a fleet."""

from typing import TYPE_CHECKING

import numpy as np

from jaxplore.report.drawing.colours import FREE, blend
from jaxplore.report.drawing.palette import LIDAR_RAY, PAPER, REFERENCE
from jaxplore.report.exploration.data import TEAM, ExplorationData, ExplorationFrame
from jaxplore.report.exploration.team import LINK, robot_colour
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


class ExplorationScene(Scene):
    """The belief, marks of parts and what moves; of one robot also the information, the scan and
    what all tasks show. Of several robots the belief is what they know together, and each has its
    colour, way and plan. It reads nothing of the true world, which a robot does not know."""

    layers: tuple[str, ...] = (
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
        self._is_team = TEAM in recording.parts
        if self._is_team:
            self.layers = ("belief", "robots", "trail", "plan", "links", "obstacles", "targets")
        self._known: list[tuple[float, ...]] = []
        rows, columns = recording.frames[0].probability.shape
        shape, side = (rows, columns), recording.resolution
        self._ground = Ground(
            shape, recording.origin, side, recording.field_origin, recording.field_resolution
        )
        # Places of the robots in the frames so far: a run that goes on has no steps yet.
        self._places: dict[int, np.ndarray] = {}
        self._size = columns * side, rows * side
        yaw = float(recording.origin[2])
        turned = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]) * self._size
        self.look_at(corners @ turned + recording.origin[:2])

    def draw_targets(self, frame: ExplorationFrame, radius: float) -> None:
        """Draw the goal, and what parts mark, as discs for a robot of a radius [m]."""
        goal = self._recording.goal
        if goal is not None and "targets/goal" not in self._nodes:
            self.ring("targets/goal", goal, radius, REFERENCE)
        known = [
            (place, each.mark_size * radius, colour)
            for each in self._recording.parts.values()
            for place, colour in each.marks(frame)
        ]
        shown = [(*place.tolist(), size, *colour) for place, size, colour in known]
        if shown == self._known:
            return
        self._known = shown
        for name in [each for each in self._nodes if each.startswith("targets/marks/")]:
            self._nodes.pop(name).remove()
        for index, (place, size, colour) in enumerate(known):
            self.ring(f"targets/marks/{index}", place, size, colour)

    def clear(self) -> None:
        """Remove everything that was drawn."""
        super().clear()
        self._known = []
        self._places = {}

    def draw(self, frame: ExplorationFrame, trail: np.ndarray) -> None:
        """Draw a frame, but for its rollouts; the trails of several robots are those of the run."""
        recording, places = self._recording, self._recording.places(frame)
        is_shown = self._is_shown("information") and frame.information.size > 0
        picture = self._ground.picture(frame.probability, frame.information if is_shown else None)
        self.picture("belief", picture, recording.origin, self._size, 0.0)
        radius, radii = float(np.max(recording.radii)), recording.mover_radii
        if self._is_team:
            self._draw_robots(frame, places)
        else:
            here = places[0].astype(np.float64)
            self._draw_scan(frame, here)
            self.trail(trail)
            self.plan(frame.plan)
            if len(frame.reference) > 1:
                pieces = segments(frame.reference[None], REFERENCES)
                self.lines("reference", pieces, REFERENCE, 3.0)
            self.body(recording.robots[0].footprint, radius, here, float(frame.headings[0]))
        if len(radii):
            self.obstacles("obstacles", frame.movers[:, None], radii, HEAD_ROOM * 2.0 * radius)
        self.draw_targets(frame, radius)

    def _draw_robots(self, frame: ExplorationFrame, places: np.ndarray) -> None:
        """Draw several robots, their ways and plans, and who hears whom."""
        recording = self._recording
        self._places[frame.step] = places
        for number, way in enumerate(self._ways(frame.step)):
            colour, radius = robot_colour(number), float(recording.radii[number])
            if len(way) > 1:
                self.lines(f"trail/{number}", segments(way[None], TRAILS), colour, 2.0)
            plan, here, heading = frame.plans[number], places[number], frame.headings[number]
            if len(plan) > 1:
                self.lines(f"plan/{number}", segments(plan[None], PLANS), colour, 4.0)
            self.disc(f"robots/{number}", here, radius, colour)
            ahead = radius * np.array([np.cos(heading), np.sin(heading)])
            nose, top = np.stack([here, here + ahead]), 2.1 * HEAD_ROOM * radius
            self.lines(f"robots/{number}/nose", segments(nose[None], top), PAPER, 3.0)
        # Of all pairs, so that the number of lines stays the same.
        first, second = np.triu_indices(recording.num_robots, 1)
        pairs = np.stack([places[first], places[second]], axis=1)
        links = frame.parts[TEAM]["links"]
        heard = np.where(links[first, second][:, None, None], pairs, np.nan)
        if len(heard):
            self.lines("links", segments(heard, REFERENCES), LINK, 1.5)

    def _draw_scan(self, frame: ExplorationFrame, here: np.ndarray) -> None:
        ends = frame.scan[:: max(1, len(frame.scan) // MOST_RAYS)]
        if len(ends):
            starts = np.broadcast_to(here, ends.shape)
            self.lines("scan", segments(np.stack([starts, ends], axis=1), SCAN), RAY, 1.0)

    def _ways(self, step: int) -> np.ndarray:
        """Return the ways (N, T, 2) of the robots up to a step [m]."""
        recording = self._recording
        if recording.num_steps:
            ways = recording.trails[:, : step + 1]
            kept = np.unique(np.linspace(0, ways.shape[1] - 1, MOST_POINTS).round().astype(int))
            return np.asarray(ways[:, kept])
        places = [each for at, each in sorted(self._places.items()) if at <= step]
        return np.stack(places, axis=1)
