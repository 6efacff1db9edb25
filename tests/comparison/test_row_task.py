"""Episodes as workers are given them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from jaxplore.study.comparison.episodes import EpisodeBatch, MapEpisode, make_episodes
from jaxplore.study.comparison.maps import maps_in
from jaxplore.study.comparison.row_task import RowTask, make_rows
from jaxplore.study.comparison.rows import Row
from jaxplore.study.comparison.store import Plan
from jaxplore.tasks.exploration.on_maps import read_grid


def test_workers_keep_to_a_map_and_explorer_then_to_the_explorer(plan: Plan) -> None:
    episodes = make_episodes(plan.maps, ("explorer", "portfolio"), (0, 1), plan.settings)
    tasks = [RowTask.from_episodes((episode,), make_rows) for episode in episodes]
    assert [task.id for task in tasks] == [episode.id for episode in episodes]
    assert len({task.id for task in tasks}) == 8
    assert [task.group for task in tasks[::2]] == [
        ("east", "explorer"),
        ("east", "portfolio"),
        ("west", "explorer"),
        ("west", "portfolio"),
    ]
    assert [task.group for task in tasks[1::2]] == [task.group for task in tasks[::2]]
    assert [task.kind for task in tasks[::2]] == ["explorer", "portfolio"] * 2


def test_a_map_is_the_same_in_any_folder(
    tmp_path: Path, plan: Plan, write_map: Callable[..., Path]
) -> None:
    write_map(tmp_path / "other" / "north.yaml", 8)
    image = tmp_path / "other" / "north.pgm"
    image.rename(tmp_path / "plan.pgm")
    text = (tmp_path / "other" / "north.yaml").read_text()
    (tmp_path / "other" / "north.yaml").write_text(
        text.replace("north.pgm", str(tmp_path / "plan.pgm"))
    )
    (north,) = make_episodes(maps_in(tmp_path / "other"), ("explorer",), (0,), plan.settings)
    seen: list[MapEpisode] = []

    def look(batch: EpisodeBatch) -> list[Row]:
        seen.extend(batch)
        raise ValueError(f"{batch[0].entries['map']} is not for me")

    task = RowTask.from_episodes((north,), look)
    ((key, read),) = task.files().items()
    assert key == north.content
    before = read_grid(north.path, 0.1)
    (tmp_path / "copy").mkdir()
    for name, data in read().items():
        (tmp_path / "copy" / name).write_bytes(data)
    (tmp_path / "plan.pgm").unlink()
    copied = task.relocate({key: tmp_path / "copy"})
    assert (copied.id, copied.group) == (task.id, task.group)
    (result,) = copied.run()
    after = read_grid(seen[0].entries["map"], 0.1)
    np.testing.assert_array_equal(after.probability, before.probability)
    assert after.resolution == before.resolution
    # The user is told of the map that is his.
    assert result.error == f"{north.path} is not for me"
