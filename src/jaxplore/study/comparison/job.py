"""Runs of a benchmark as workers are given them."""

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path

from jaxplore.maps.files.packing import PACKED, pack_map
from jaxplore.study.comparison.perform import Perform, results_for
from jaxplore.study.comparison.rows import Result, failed_row, result_of
from jaxplore.study.comparison.tasks import Batch
from jaxplore.study.workers.job import Job, Read


@dataclasses.dataclass(frozen=True)
class Runs(Job):
    """The tasks of a batch. Their results are the answer.

    Args:
        batch: what is to be done.
        make: makes the runs. Other processes find it by its module and name.
    """

    batch: Batch
    make: Perform

    @property
    def id(self) -> str:
        """The first task's."""
        return self.batch[0].id

    @property
    def group(self) -> tuple[str, str]:
        """Map and explorer."""
        return self.batch[0].group

    @property
    def kind(self) -> str:
        """The explorer: on a map of the same shape its loop is compiled."""
        return self.batch[0].explorer

    def files(self) -> Mapping[str, Read]:
        """Return what reads the map."""
        return {self.batch[0].content: functools.partial(pack_map, self.batch[0].path)}

    def located(self, folders: Mapping[str, Path]) -> "Runs":
        """Return the same runs on a copy of the map."""
        copy = str(folders[self.batch[0].content] / PACKED)
        batch = tuple(dataclasses.replace(task, copy=copy) for task in self.batch)
        return Runs(batch, self.make)

    def run(self) -> tuple[Result, ...]:
        """Make the runs."""
        return results_for(self.batch, self.make)

    def failed(self, reason: str) -> tuple[Result, ...]:
        """Return rows with an error."""
        return tuple(result_of(failed_row(task, reason)) for task in self.batch)
