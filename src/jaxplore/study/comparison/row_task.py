"""Tasks that run episodes of a comparison on maps and return rows of results."""

import dataclasses
from collections.abc import Callable, Sequence

import jax

from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.study.comparison.episodes import EpisodeBatch
from jaxplore.study.comparison.rows import Row, StoredRow, make_failed_row, make_row, store_row
from jaxplore.study.episode import EpisodeTask, InputFile
from jaxplore.study.experiments import SideBySide, record_alone
from jaxplore.tasks.exploration.build import build_exploration, with_start
from jaxplore.tasks.exploration.settings import make_exploration_settings

MakeRows = Callable[[EpisodeBatch], Sequence[Row]]
"""Runs a batch of episodes and returns their rows. Other processes import it by name."""


def make_rows(batch: EpisodeBatch) -> tuple[Row, ...]:
    """Run a batch of episodes and return their rows; several episodes run in one `jax.vmap`."""
    first = batch[0]
    settings = make_exploration_settings(with_start(first.entries))
    experiment = build_exploration(settings, first.map_shape)
    if first.batch == 1:
        recordings = {first.seed: record_alone(experiment)}
    else:
        # On a map only the key of an experiment depends on the seed, so the experiment is built
        # once.
        experiments = [experiment._replace(key=jax.random.key(seed)) for seed in first.seeds]
        together = SideBySide(first.batch).record("", experiments, with_frames=True)
        recordings = dict(zip(first.seeds, together, strict=True))
    rows = []
    for episode in batch:
        recording = recordings[episode.seed]
        # Maps are always explored, so the recording has the columns of a row.
        assert isinstance(recording, ExplorationRecording)
        # The results name the user's file and not its copy on another machine.
        asked = settings.model_copy(update={"map": episode.path, "seed": episode.seed})
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
            file=InputFile("map", first.path, first.content),
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
