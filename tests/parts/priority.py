"""A part of which nothing in the package knows: its folder, as one module, and its row."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp

import jaxplore as jx
from jaxplore.parts.capability import Built, Capability
from jaxplore.report import Column, PartMetrics, PartReport
from jaxplore.settings.defaults import arguments, setting
from jaxplore.settings.sections import Positive, Real, Section
from jaxplore.simulation import PartTruth


# robot
class Priority(jx.belief.Part):
    """Cells of a rectangle (x_min, y_min, x_max, y_max) [m] are worth more until they are seen.

    Args:
        box: the rectangle [m].
        worth: what a cell is worth [nat].
    """

    name = "priority"
    box: jax.Array
    worth: jax.Array

    def __init__(self, box, worth: float = 1.0) -> None:
        self.box, self.worth = jnp.asarray(box, jnp.float32), jnp.asarray(worth, jnp.float32)

    def init(self, grid):
        height, width = grid.shape
        cells = jnp.stack(jnp.mgrid[:height, :width], axis=-1)
        centres = grid.frame.cell_centre(cells)
        return ((centres >= self.box[:2]) & (centres <= self.box[2:])).all(axis=-1)

    def observe(self, own, observation):
        return own & ~observation.is_seen

    def interest(self, own):
        return self.worth * own

    def merge(self, own, told, is_heard):
        return own & (told | ~is_heard[:, None, None]).all(axis=0)


# report
class PriorityRecord(NamedTuple):
    left: jax.Array


@dataclasses.dataclass(frozen=True, kw_only=True)
class PriorityMetrics(PartMetrics):
    left: int
    seen: int
    columns = (Column.quartiles("left", "cells left"),)

    def rows(self):
        return [("priority", f"{self.left} cells left")]


class PriorityReport(PartReport):
    name = "priority"
    record_type = PriorityRecord

    def metrics(self, run):
        left = run.records.parts[self.name].left
        # A fleet has a column for each robot.
        least = left.min(axis=-1) if left.ndim > 1 else left
        return PriorityMetrics(left=int(least[-1]), seen=int(left.max() - least[-1]))


# truth
class PriorityTruth(PartTruth):
    name = "priority"
    is_default = True
    is_judging = True

    def init(self, pose):
        return PriorityRecord(jnp.zeros((), jnp.int32))

    def judge(self, own, known, reachable, number, time):
        return PriorityRecord(jnp.sum(known, dtype=jnp.int32))

    def record(self, own):
        return own

    def report(self, part, known, own, grid):
        return PriorityReport()


# settings
class PrioritySettings(Section):
    """A rectangle that is seen first: see `Priority`.

    Args:
        box: the rectangle (x_min, y_min, x_max, y_max) [m].
    """

    box: tuple[Real, Real, Real, Real]
    worth: Positive = setting(Priority, "worth")


def build_priority(given, around):
    low, high = (around.datum.to_local(given.box[at : at + 2]) for at in (0, 2))
    return Built(Priority([*low, *high], **arguments(given, Priority)))


PRIORITY = Capability(
    name="priority",
    meaning="a rectangle that is seen first; none when absent.",
    settings=PrioritySettings,
    build=build_priority,
)
