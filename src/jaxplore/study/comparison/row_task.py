"""Tasks that run episodes of a comparison on maps and return rows of results."""

import dataclasses
from collections.abc import Callable, Sequence

from jaxplore.simulation.experiment import Experiment
from jaxplore.study.comparison.episodes import EpisodeBatch
from jaxplore.study.comparison.maps import kind_of_map
from jaxplore.study.comparison.rows import Row, StoredRow, make_failed_row, make_row, store_row
from jaxplore.study.episode import EpisodeTask, InputFile
from jaxplore.study.experiments import SideBySide, record_alone

MakeRows = Callable[[EpisodeBatch], Sequence[Row]]
"""Runs a batch of episodes and returns their rows. Other processes import it by name."""


def make_rows(batch: EpisodeBatch) -> tuple[Row, ...]:
    """Run a batch of episodes and return their rows; several episodes run in one `jax.vmap`."""
    first = batch[0]
    kind, compared = kind_of_map(first.selector)
    settings = kind.make_settings(kind.with_start(first.entries))

    def build(seed: int) -> Experiment:
        own = settings.model_copy(update={"seed": seed})
        return compared.build(own, first.map_shape)

    if first.batch == 1:
        recordings = {first.seed: record_alone(build(first.seed))}
    else:
        experiments = [build(seed) for seed in first.seeds]
        together = SideBySide(first.batch).record("", experiments, with_frames=True)
        recordings = dict(zip(first.seeds, together, strict=True))
    rows = []
    for episode in batch:
        recording = recordings[episode.seed]
        # The results name the user's file and not its copy on another machine.
        asked = settings.model_copy(update={first.selector: episode.path, "seed": episode.seed})
        metrics = recording.metrics(seed=episode.seed)
        rows.append(make_row(episode, recording, metrics, settings=asked))
    return tuple(rows)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RowTask(EpisodeTask):
    """A batch of episodes on a map, which `make` runs. The result is their rows."""

    episodes: EpisodeBatch
    make: MakeRows = make_rows

    @classmethod
    def from_episodes(cls, episodes: EpisodeBatch, make: MakeRows = make_rows) -> "RowTask":
        """Make the task of a batch of episodes."""
        first = episodes[0]
        return cls(
            name=first.id,
            variant=first.explorer,
            scenario=first.map,
            # A generated map has no content, and no file.
            file=InputFile(first.selector, first.path, first.content) if first.content else None,
            episodes=episodes,
            make=make,
        )

    def measure(self) -> tuple[StoredRow, ...]:
        """Run the episodes and return their rows."""
        batch = self.episodes
        if self.copy is not None:
            batch = tuple(dataclasses.replace(each, copy=self.copy) for each in batch)
        return tuple(map(store_row, self.make(batch)))

    def make_failure(self, reason: str) -> tuple[StoredRow, ...]:
        """Return rows with an error."""
        return tuple(store_row(make_failed_row(each, reason)) for each in self.episodes)
