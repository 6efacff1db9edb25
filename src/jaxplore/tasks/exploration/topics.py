"""What is recorded of an exploration."""

from typing import Any

import numpy as np

from jaxplore.report.drawing.colours import MOVER
from jaxplore.report.drawing.palette import HEAT, MAX_HEAT, REFERENCE
from jaxplore.report.exploration.data import ExplorationFrame
from jaxplore.topics import messages
from jaxplore.topics.content import BASE, MAP, MARK, Content

UNKNOWN_LEVEL = 128
"""Level of the probability 1/2 of 255."""
FREE_LEVEL = 64
"""Level of a probability, of 255, below which a cell is free."""
BRIGHTEST_PERCENT = 98.0
"""Share of the nodes that are darker than the brightest colour of the information [%]."""


class ExplorationContent(Content):
    """What is recorded of an exploration.

    In addition to the commands, states and metrics these are the pose, the scan, the plan,
    rollouts, what moves, the targets and the terms of the plan's cost; every half second the belief
    and the information.
    """

    _angles: tuple[float, float] | None = None
    _brightest = 1e-6

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
        names = list(run.state_names)
        here = frame.state[[names.index("x"), names.index("y")]]
        z = float(frame.state[names.index("z")]) if "z" in names else 0.0
        self.log_pose(time, here, frame.heading, z)
        self._log_scan(frame, here)
        self.log_plan(frame, reference=(frame.reference, REFERENCE))
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
            "robot": self.body(),
            "moving obstacles": (MAP, {"cylinders": movers}),
            "targets": self.mark_targets(frame),
            "goal": (MAP, {"cylinders": goal}),
            "parts": (MAP, {"cylinders": objects}),
        }
        self.log("/objects", messages.scene(self.channels.stamp(time), entities), time)

    def write_maps(self, frame: ExplorationFrame) -> None:
        """Write the belief and the information."""
        self.log_levels("/belief", frame.probability, frame.time, -messages.FLAT)
        self._log_information(frame)

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
