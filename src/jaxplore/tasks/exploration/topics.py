"""What is recorded of an exploration, by one robot or several."""

from typing import Any

import numpy as np

from jaxplore.control.base import Controller
from jaxplore.report.drawing.colours import MOVER
from jaxplore.report.drawing.palette import HEAT, MAX_HEAT, REFERENCE
from jaxplore.report.exploration.data import TEAM, ExplorationData, ExplorationFrame
from jaxplore.report.exploration.team import LINK, robot_colour
from jaxplore.report.recording import robot_columns
from jaxplore.topics import messages
from jaxplore.topics.channels import Channels
from jaxplore.topics.content import BASE, MAP, MARK, Content, evenly

UNKNOWN_LEVEL = 128
"""Level of the probability 1/2 of 255."""
FREE_LEVEL = 64
"""Level of a probability, of 255, below which a cell is free."""
BRIGHTEST_PERCENT = 98.0
"""Share of the nodes that are darker than the brightest colour of the information [%]."""
MOST_TRAIL = 500
"""Greatest number of points of a trail in a message."""
OWN = ("clearance", "is_collision")
"""Fields of a record with one value for each of several robots, which are among its metrics."""


class ExplorationContent(Content):
    """What is recorded of an exploration.

    In addition to the commands, states and metrics these are the pose, the scan, the plan,
    rollouts, what moves, the targets and the terms of the plan's cost; every half second the belief
    and the information.

    Of several robots the belief is what they know together, and each has under its name, `robot1`
    for the first, its pose, plan and metrics, every half second its trail, and at the end its map.
    Lines join the robots that hear each other.
    """

    _angles: tuple[float, float] | None = None
    _brightest = 1e-6

    def __init__(
        self, channels: Channels, recording: ExplorationData, controller: Controller
    ) -> None:
        super().__init__(channels, recording, controller)
        self._columns = list(robot_columns(recording.state_names).values())
        self._names: list[str] = []
        if TEAM in recording.parts:
            self._names = [f"robot{number + 1}" for number in range(recording.num_robots)]
            # Pieces (N, steps, 2) of the trails, in the order of the updates.
            self._trails = [recording.trails]

    def write_steps(self, records: Any, times: np.ndarray, text: str | None = None) -> None:
        """Write the records of steps, of several robots also the metrics of each."""
        super().write_steps(records, times, text)
        if not len(times) or not self._names:
            return
        states = [records.state[:, [own["x"], own["y"]]] for own in self._columns]
        self._trails.append(np.stack(states))
        team = records.parts[TEAM]
        rows = {name: getattr(records, name) for name in OWN}
        rows |= {"coverage": team.coverages, "is_contact": team.is_contact}
        for number, name in enumerate(self._names):
            own = {shown: each[:, number] for shown, each in rows.items()}
            values = {
                shown: float(each.any() if each.dtype == bool else each[-1])
                for shown, each in own.items()
            }
            self.channels.log_values(f"/{name}/metrics", values, float(times[-1]))

    def write_start(self) -> None:
        """Write the true map, unless nothing is known of it."""
        run = self.recording
        world = np.round(255.0 * np.asarray(run.world)).astype(np.uint8)
        # A real robot has no true map: its recording says 1/2 everywhere.
        if (np.asarray(run.world) != 0.5).any():
            self.log_levels("/world", world, run.frames[0].time, -2.0 * messages.FLAT)

    def write_scene(self, frame: ExplorationFrame) -> None:
        """Write the pose, the scan, the plan, rollouts, and what moves or is found."""
        run, time = self.recording, frame.time
        places = run.places(frame)
        if self._names:
            robots = self._write_robots(frame, places)
        else:
            columns, here = self._columns[0], places[0]
            z = float(frame.state[columns["z"]]) if "z" in columns else 0.0
            self.log_pose(time, here, float(frame.headings[0]), z)
            self._log_scan(frame, here)
            self.log_plan(frame, reference=(frame.reference, REFERENCE))
            robots = {"robot": self.body()}
        if frame.terms:
            self.channels.log_values("/cost_terms", frame.terms, time)
        movers = [
            messages.disc(middle, float(radius), MOVER)
            for middle, radius in zip(frame.movers, run.mover_radii, strict=True)
            if np.isfinite(middle).all()
        ]
        objects = [
            messages.disc(place, MARK, colour)
            for each in run.parts.values()
            for place, colour in each.marks(frame)
        ]
        goal = [] if run.goal is None else [messages.disc(run.goal, MARK, REFERENCE)]
        entities: dict[str, Any] = {
            **robots,
            "moving obstacles": (MAP, {"cylinders": movers}),
            "goal": (MAP, {"cylinders": goal}),
            "parts": (MAP, {"cylinders": objects}),
        }
        self.log("/objects", messages.scene(self.channels.stamp(time), entities), time)

    def _write_robots(self, frame: ExplorationFrame, places: np.ndarray) -> dict[str, Any]:
        """Write the poses and plans of several robots; return them, and who hears whom, as entities
        of a scene."""
        stamp, entities, headings = self.channels.stamp(frame.time), {}, frame.headings.tolist()
        for number, name in enumerate(self._names):
            place, colour = places[number], robot_colour(number)
            self.log_pose(frame.time, place, headings[number], 0.0, robot=name)
            line = messages.line(frame.plans[number], colour, 3.0, z=2.0 * messages.FLAT)
            update = messages.scene(stamp, {"plan": (MAP, {"lines": [line]})})
            self.log(f"/{name}/plan", update, frame.time)
            body = messages.disc(np.zeros(2), float(self.recording.radii[number]), colour)
            entities[name] = (f"{name}/{BASE}", {"cylinders": [body]})
        pairs = np.argwhere(np.triu(frame.parts[TEAM]["links"], 1))
        lines = [messages.line(places[pair], LINK, 1.0) for pair in pairs]
        return {**entities, "links": (MAP, {"lines": lines})}

    def write_maps(self, frame: ExplorationFrame) -> None:
        """Write the belief and the information, of several robots also their trails up to now."""
        self.log_levels("/belief", frame.probability, frame.time, -messages.FLAT)
        if not self._names:
            self._log_information(frame)
            return
        self._trails = [np.concatenate(self._trails, axis=1)]
        shown = self._trails[0][:, evenly(self._trails[0].shape[1], MOST_TRAIL)]
        stamp = self.channels.stamp(frame.time)
        for number, name in enumerate(self._names):
            line = messages.line(shown[number], robot_colour(number), 2.0, z=messages.FLAT)
            update = messages.scene(stamp, {"trail": (MAP, {"lines": [line]})})
            self.log(f"/{name}/trail", update, frame.time)

    def write_end(self, recording: ExplorationData) -> None:
        """Write the map of each of several robots."""
        time = float(recording.num_steps * recording.control_period)
        maps = recording.parts[TEAM].arrays()["beliefs"] if self._names else ()
        for name, levels in zip(self._names, maps, strict=True):
            self.log_levels(f"/{name}/belief", levels, time, -messages.FLAT)

    def _log_information(self, frame: ExplorationFrame) -> None:
        """Write the information; its colour covers free cells only, as in the animation."""
        run = self.recording
        information = np.asarray(frame.information, np.float32)
        known = np.nan_to_num(information)
        # The colours of a run get no brighter when little is left to learn.
        self._brightest = max(self._brightest, float(np.percentile(known, BRIGHTEST_PERCENT)))
        stride = max(1, round(run.field_resolution / run.resolution))
        level = np.full(information.shape, UNKNOWN_LEVEL, np.uint8)
        near = frame.probability[stride // 2 :: stride, stride // 2 :: stride]
        rows, columns = (min(pair) for pair in zip(near.shape, level.shape, strict=True))
        level[:rows, :columns] = near[:rows, :columns]
        alpha = 255.0 * MAX_HEAT * np.clip(known / self._brightest, 0.0, 1.0)
        values = {
            "information": information,
            **{
                name: np.full(information.shape, HEAT[i], np.uint8)
                for i, name in enumerate(("red", "green", "blue"))
            },
            "alpha": np.where(level < FREE_LEVEL, alpha, 0.0).astype(np.uint8),
        }
        stamp = self.channels.stamp(frame.time)
        message = messages.grid(stamp, MAP, run.field_origin, run.field_resolution, values)
        self.log("/information", message, frame.time)

    def _log_scan(self, frame: ExplorationFrame, here: np.ndarray) -> None:
        """Write the scan, as ranges if its beams are at even angles, else as points."""
        if not len(frame.scan):
            return
        stamp, offset = self.channels.stamp(frame.time), frame.scan.astype(np.float64) - here
        ranges = np.hypot(*offset.T)
        if self._angles is None:
            bearings = np.arctan2(offset[:, 1], offset[:, 0]) - frame.heading
            # A short range says little about the angle of its beam.
            self._angles = messages.even_angles(np.where(ranges > 0.1, bearings, np.nan))
        if self._angles is None:
            ends = frame.scan[np.isfinite(frame.scan).all(axis=-1)]
            self.log("/points", messages.point_cloud(stamp, MAP, ends), frame.time)
            return
        message = messages.laser_scan(stamp, BASE, self._angles, ranges)
        self.log("/scan", message, frame.time)
