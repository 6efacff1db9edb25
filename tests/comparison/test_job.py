"""Runs as workers are given them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from jaxplore.study.comparison.job import Runs
from jaxplore.study.comparison.maps import maps_in, read_grid
from jaxplore.study.comparison.perform import perform
from jaxplore.study.comparison.rows import Row
from jaxplore.study.comparison.store import Asked
from jaxplore.study.comparison.tasks import Batch, Task, make_tasks


def test_workers_keep_to_a_map_and_explorer_then_to_the_explorer(asked: Asked) -> None:
    tasks = make_tasks(asked.maps, ("explorer", "portfolio"), (0, 1), asked.settings)
    jobs = [Runs((task,), perform) for task in tasks]
    assert [job.id for job in jobs] == [task.id for task in tasks]
    assert len({job.id for job in jobs}) == 8
    assert [job.group for job in jobs[::2]] == [
        ("east", "explorer"),
        ("east", "portfolio"),
        ("west", "explorer"),
        ("west", "portfolio"),
    ]
    assert [job.group for job in jobs[1::2]] == [job.group for job in jobs[::2]]
    assert [job.kind for job in jobs[::2]] == ["explorer", "portfolio"] * 2


def test_a_map_is_the_same_in_any_folder(
    tmp_path: Path, asked: Asked, write_map: Callable[..., Path]
) -> None:
    write_map(tmp_path / "other" / "north.yaml", 8)
    image = tmp_path / "other" / "north.pgm"
    image.rename(tmp_path / "plan.pgm")
    text = (tmp_path / "other" / "north.yaml").read_text()
    (tmp_path / "other" / "north.yaml").write_text(
        text.replace("north.pgm", str(tmp_path / "plan.pgm"))
    )
    (north,) = make_tasks(maps_in(tmp_path / "other"), ("explorer",), (0,), asked.settings)
    seen: list[Task] = []

    def look(batch: Batch) -> list[Row]:
        seen.extend(batch)
        raise ValueError(f"{batch[0].entries['map']} is not for me")

    job = Runs((north,), look)
    ((key, read),) = job.files().items()
    assert key == north.content
    before = read_grid(north.path, 0.1)
    (tmp_path / "copy").mkdir()
    for name, data in read().items():
        (tmp_path / "copy" / name).write_bytes(data)
    (tmp_path / "plan.pgm").unlink()
    copied = job.located({key: tmp_path / "copy"})
    assert (copied.id, copied.group) == (job.id, job.group)
    (result,) = copied.run()
    after = read_grid(seen[0].entries["map"], 0.1)
    np.testing.assert_array_equal(after.probability, before.probability)
    assert after.resolution == before.resolution
    # The user is told of the map that is his.
    assert result.error == f"{north.path} is not for me"
