"""What a run shows of several robots beside each of them: contacts, the radio, who knows what."""

import dataclasses
import math
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float
from PIL import ImageDraw

from jaxplore._types import Count, Scalar
from jaxplore.report._numbers import percent, text
from jaxplore.report.coverage_levels import at_instants
from jaxplore.report.drawing.colours import SERIES
from jaxplore.report.drawing.footer import Entry
from jaxplore.report.drawing.palette import Colour
from jaxplore.report.drawing.shapes import Surface, draw_line
from jaxplore.report.exploration.data import TEAM, ExplorationData, ExplorationFrame
from jaxplore.report.exploration.localisation import trajectory_errors
from jaxplore.report.exploration.progress import is_known_map
from jaxplore.report.metrics import Column
from jaxplore.report.motion import episodes
from jaxplore.report.part import PartMetrics, PartReport

LINK = (70, 140, 60)
"""Colour of the line between two robots that hear each other."""
MOST_NAMED = 12
"""Greatest number of robots in the legend."""


def robot_colour(number: int) -> tuple[int, int, int]:
    """Return the colour of a robot, the same as in the figures."""
    code = SERIES[number % len(SERIES)]
    red, green, blue = (int(code[at : at + 2], 16) for at in (1, 3, 5))
    return red, green, blue


class TeamRecord(NamedTuple):
    """What a step records of several robots together.

    Args:
        coverages: (N,) share of the reachable cells that each robot knew to be free.
        is_contact: (N,) whether each robot would have touched another one; it stopped instead.
        sent: size of all messages with maps and ways in the step [bytes].
        links: number of pairs of robots that heard each other.
    """

    coverages: Float[Array, " N"]
    is_contact: Bool[Array, " N"]
    sent: Scalar
    links: Count


@dataclasses.dataclass(frozen=True, kw_only=True)
class TeamMetrics(PartMetrics):
    """Metrics of several robots together.

    Args:
        num_robots: number of robots, N.
        coordination: how the robots divided the places among themselves.
        contacts: contacts between robots: successive steps in which some robot was stopped because
            it would have touched another one are one.
        exchanged: size of all messages with maps and ways [bytes].
        linked: share of the pairs of robots that heard each other, mean over the steps; None
            without pairs.
        least_coverage: coverage of the map of the robot that knows the least at the end; None on a
            map that was known in advance.
        path_lengths: distance that each robot drove (N,) [m].
        ates: absolute trajectory error of each robot (N,), as `ExplorationMetrics.ate` [m]; empty
            if the robots knew their poses, as are the ones below.
        odometry_ates: the same error of its odometry alone (N,) [m].
        position_errors: root mean square over the steps of the distance of each robot from where it
            takes itself to be (N,) [m]. The frame is that of all robots: nothing is aligned.
        frames_found_at: times at which pairs of robots found how their frames lie to each other
            [s], the earliest first; None if they knew it from the start, as below.
        frame_errors: by how much each of them was off in the middle of a map [m].
    """

    num_robots: int
    coordination: str
    contacts: int
    exchanged: float
    linked: float | None
    least_coverage: float | None
    path_lengths: tuple[float, ...]
    ates: tuple[float | None, ...] = ()
    odometry_ates: tuple[float | None, ...] = ()
    position_errors: tuple[float, ...] = ()
    frames_found_at: tuple[float, ...] | None = None
    frame_errors: tuple[float, ...] | None = None

    columns = (
        Column.total("contacts", "contacts"),
        Column.quartiles("exchanged", "exchanged [MB]", digits=2, scale=1e-6),
        Column.quartiles(
            "ate",
            "trajectory error [m]",
            number=lambda each: max((ate for ate in each.ates if ate is not None), default=None),
            digits=3,
            missing=math.nan,
            applies=lambda spread: math.isfinite(spread[1]),
        ),
    )

    def rows(self) -> list[tuple[str, str]]:
        """Return the metrics as (name, text), for tables."""
        each = ", ".join(f"{metres:.1f}" for metres in self.path_lengths)
        rows = [("robots", f"{self.num_robots}, coordination: {self.coordination}")]
        if self.least_coverage is not None:
            rows.append(("least known", f"{percent(self.least_coverage)} by one robot"))
        rows += [
            ("paths", f"{each} m"),
            ("contacts", f"{self.contacts} between robots"),
            ("exchanged", f"{1e-6 * self.exchanged:.2f} MB"),
        ]
        errors = {
            "position errors": (self.position_errors, 3),
            "trajectory errors": (self.ates, 3),
            "  of odometry, each": (self.odometry_ates, 2),
        }
        for name, (values, digits) in errors.items():
            if values:
                rows.append((name, f"{', '.join(text(value, digits) for value in values)} m"))
        if self.frames_found_at is not None and self.frame_errors is not None:
            number = self.num_robots * (self.num_robots - 1) // 2
            found = f"{len(self.frames_found_at)} of {number} pairs"
            if self.frames_found_at:
                found += (
                    f", the last at {max(self.frames_found_at):.0f} s, off by at most "
                    f"{max(self.frame_errors):.3f} m"
                )
            rows.append(("frames found", found))
        return rows


@dataclasses.dataclass(frozen=True)
class TeamReport(PartReport):
    """What a run shows of several robots together.

    Args:
        coordination: how the robots divided the places among themselves.
        beliefs: (N, H, W) map of each robot at the end, in 256 levels.
        merges: time [s] and error [m] of each pair of robots that has found how its frames lie;
            None if all knew it from the start.
    """

    name: ClassVar[str] = TEAM
    record_type: ClassVar[type | None] = TeamRecord

    coordination: str
    beliefs: np.ndarray
    merges: tuple[tuple[float, float], ...] | None = None

    def metrics(self, run: ExplorationData) -> TeamMetrics:
        """Compute the metrics."""
        record, robots = run.records.parts[self.name], run.robots
        pairs = len(robots) * (len(robots) - 1) // 2
        places = [each.localisation for each in robots if each.localisation is not None]
        errors = [trajectory_errors(each) for each in places if len(each.poses)]
        least = None
        if not is_known_map(run):
            last = at_instants(record.coverages, np.full(len(robots), run.initial_coverage))[-1]
            least = float(last.min())
        shifts = [each.pose_error for each in robots if each.pose_error is not None]
        merges = None if self.merges is None else sorted(self.merges)
        return TeamMetrics(
            num_robots=len(robots),
            coordination=self.coordination,
            contacts=episodes(np.asarray(record.is_contact, bool).any(axis=-1)),
            exchanged=float(np.sum(record.sent, dtype=np.float64)),
            linked=float(np.mean(record.links) / pairs) if pairs and run.num_steps else None,
            least_coverage=least,
            path_lengths=tuple(float(each.lengths[-1]) for each in robots),
            ates=tuple(each["ate"] for each in errors),
            odometry_ates=tuple(each["odometry_ate"] for each in errors),
            position_errors=tuple(
                float(np.sqrt(np.nanmean(np.square(each.astype(np.float64)))))
                for each in shifts
                if len(each)
            ),
            frames_found_at=None if merges is None else tuple(at for at, _ in merges),
            frame_errors=None if merges is None else tuple(error for _, error in merges),
        )

    def series(self, run: ExplorationData) -> dict[str, np.ndarray]:
        """Return the coverage by the map of each robot at all instants."""
        start = np.full(run.num_robots, run.initial_coverage)
        rows = at_instants(run.records.parts[self.name].coverages, start).T
        return {f"robot {number}": each for number, each in enumerate(rows, start=1)}

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the map of each robot."""
        return {"beliefs": self.beliefs}

    def draw(
        self,
        surface: Surface,
        draw: ImageDraw.ImageDraw,
        run: ExplorationData,
        frame: ExplorationFrame,
    ) -> None:
        """Draw a line between two robots that hear each other."""
        places = run.places(frame)
        for pair in np.argwhere(np.triu(frame.parts[self.name]["links"], 1)):
            draw_line(surface, draw, places[pair], LINK, 1.0)

    def legend(self) -> list[Entry]:
        """Return an entry for each robot, and for the radio."""
        number = len(self.beliefs)
        robots = [
            Entry(f"robot {i + 1}", robot_colour(i), "disc") for i in range(min(number, MOST_NAMED))
        ]
        return [*robots, *([Entry("radio", LINK, "line")] if number > 1 else [])]

    def colours(self) -> list[Colour]:
        """Return the colours of the robots and of the radio."""
        robots = min(len(self.beliefs), len(SERIES))
        return [*(robot_colour(number) for number in range(robots)), LINK]
