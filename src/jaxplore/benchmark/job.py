"""Runs of a benchmark as workers are given them."""

import dataclasses
import functools
import io
from collections.abc import Mapping
from pathlib import Path

import yaml

from jaxplore.benchmark.maps import image_of
from jaxplore.benchmark.perform import Perform, results_for
from jaxplore.benchmark.rows import Result, failed_row, result_of
from jaxplore.benchmark.tasks import Batch
from jaxplore.maps._files import read_yaml
from jaxplore.workers.job import Files, Job, Read

_MAP = "map.yaml"


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
        return {self.batch[0].content: functools.partial(_packed, self.batch[0].path)}

    def located(self, folders: Mapping[str, Path]) -> "Runs":
        """Return the same runs on a copy of the map."""
        copy = str(folders[self.batch[0].content] / _MAP)
        batch = tuple(dataclasses.replace(task, copy=copy) for task in self.batch)
        return Runs(batch, self.make)

    def run(self) -> tuple[Result, ...]:
        """Make the runs."""
        return results_for(self.batch, self.make)

    def failed(self, reason: str) -> tuple[Result, ...]:
        """Return rows with an error."""
        return tuple(result_of(failed_row(task, reason)) for task in self.batch)


def _packed(path: str) -> Files:
    """Return the files of a map so that they can lie in any folder."""
    entries, image = read_yaml(Path(path)), image_of(path)
    if image is None:
        return {_MAP: Path(path).read_bytes()}
    name = f"map{image.suffix}"
    text = io.StringIO()
    yaml.safe_dump({**entries, "image": name}, text, sort_keys=False, allow_unicode=True)
    return {_MAP: text.getvalue().encode(), name: image.read_bytes()}
