"""Valid files of every format, which cases refer to and mutations begin with."""

import contextlib
import os
import random
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import yaml
from PIL import Image

from jaxplore.cli import main
from jaxplore.maps.terrain import TerrainMap
from jaxplore.report.exploration.metrics import ExplorationMetrics
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.ros.bag_writer import BagWriter
from jaxplore.simulation.run import Run
from jaxplore.study.comparison.row_task import RowTask
from jaxplore.study.comparison.rows import make_row, store_row
from jaxplore.study.runner import Runner
from jaxplore.study.tuning.episodes import MetricsTask, Result
from jaxplore.study.tuning.objective import flat, with_late_times
from jaxplore.tasks.exploration.settings import make_exploration_settings

BASE = "base"
"""Folder of the valid files, beside the folders of the cases."""
FEW = ["--samples", "16", "--beams", "16", "--range", "1", "--set", "fields.num_directions=8"]
FEW += ["--set", "controller.horizon=8"]
# With these rates, those of comparisons on maps, they share the loop of the tests of these.
FEW += ["--set", "rates={control: 20, sensing: 10, fields: 5}"]
"""Options of a run that compiles and computes little."""
ROOM: dict[str, Any] = {
    "size": [4.0, 3.0],
    "resolution": 0.1,
    "start": [1.0, 1.5, 0.0],
    "zones": [[0.0, 0.0, 4.0, 3.0]],
}
WORLD: dict[str, Any] = {
    **ROOM,
    "origin": [0.0, 0.0],
    "wall_reach": 0.1,
    "goal": [3.0, 1.5],
    "zones": [[2.0, 0.0, 4.0, 3.0]],
    "walls": [[0.0, 0.0, 4.0, 0.0]],
    "hidden": {"rectangles": [[2.0, 2.0, 2.4, 2.4]], "discs": [[3.0, 0.6, 0.2]]},
    "hills": [[3.0, 2.0, 0.1, 1.0]],
    "targets": [[3.5, 0.5]],
    "objects": [{"position": [3.5, 2.5], "label": "extinguisher"}],
    "movers": [{"path": [[0.5, 0.5], [1.0, 0.5]], "speed": 0.2, "radius": 0.1}],
    "forbidden": [[0.0, 2.6, 0.4, 3.0]],
}
"""A world with every entry."""
MAP: dict[str, Any] = {
    "image": "map.pgm",
    "resolution": 0.1,
    "origin": [0.0, 0.0, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
    "mode": "trinary",
}
NAV2: dict[str, Any] = {
    "controller_server": {
        "ros__parameters": {
            "controller_frequency": 20.0,
            "FollowPath": {
                "plugin": "nav2_mppi_controller::MPPIController",
                "time_steps": 40,
                "model_dt": 0.1,
                "batch_size": 800,
                "vx_max": 0.7,
                "vx_min": -0.2,
                "vx_std": 0.3,
                "wz_max": 1.5,
                "wz_std": 0.5,
                "ax_max": 2.0,
                "temperature": 0.25,
                "gamma": 0.015,
                "motion_model": "DiffDrive",
                "critics": ["CostCritic", "PathFollowCritic"],
                "CostCritic": {"enabled": True, "cost_weight": 7.62},
                "PathFollowCritic": {"cost_weight": 2.5},
            },
        }
    },
    "local_costmap": {"local_costmap": {"ros__parameters": {"robot_radius": 0.22}}},
}
SETTINGS: dict[str, Any] = {
    "seed": 3,
    "time_limit": 2.0,
    "robot": {"radius": 0.2, "max_speed": 0.8},
    "lidar": {"num_beams": 16, "max_range": 1.0},
    "controller": {"num_samples": 16, "horizon": 8, "temperature": 0.5},
    "fields": {"num_directions": 8},
    "parameters": {"cost.information.weight": 2.0},
    "start": [1.0, 1.5, 0.0],
}
NODE: dict[str, Any] = {
    "robot": {"radius": 0.2},
    "node": {"scan_topic": "/scan", "latency": 0.1, "lidar_x": 0.1},
}
POSES: dict[str, Any] = {
    "header": {"frame_id": "map"},
    "poses": [
        {"pose": {"position": {"x": x, "y": 0.2 * x * x, "z": 0.0}}} for x in (0.0, 1.0, 2.0, 4.0)
    ],
}
STUDY = (
    "tune",
    "{base}/room.yaml",
    *FEW,
    "--tune",
    "controller.temperature",
    "--budget",
    "3",
    "--seeds",
    "1",
)
STUDY += ("--unseen", "1", "--population", "3", "--no-animation", "--out", "study")
COMPARISON = (
    "compare",
    "--maps",
    "{base}/maps",
    *FEW,
    "--architectures",
    "explorer",
    "--seeds",
    "2",
)
COMPARISON += ("--out", "comparison")


def room_image() -> Image.Image:
    """Return the picture of a room of 40 x 30 cells with a pillar."""
    pixels = np.full((30, 40), 254, np.uint8)
    pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1] = 0, 0, 0, 0
    pixels[12:16, 26:29] = 0
    pixels[20:22, 5:9] = 205
    return Image.fromarray(pixels)


def write_files(base: Path) -> None:
    """Write maps, worlds, paths, settings, parameters of nav2, a terrain and a bag."""
    base.mkdir()
    image = room_image()
    for folder in (base, base / "maps"):
        folder.mkdir(exist_ok=True)
        for name in ("map.pgm", "map.png", "map.bmp"):
            image.save(folder / name)
    documents = {
        "map.yaml": MAP,
        "png.yaml": MAP | {"image": "map.png"},
        "maps/east.yaml": MAP,
        "maps/west.yaml": MAP | {"image": "map.png"},
        "maps/starts.yaml": {"east": [1.0, 1.5, 0.5]},
        "room.yaml": ROOM,
        "world.yaml": WORLD,
        "nav2.yaml": NAV2,
        "settings.yaml": SETTINGS,
        "node.yaml": NODE,
        "path.yaml": POSES,
    }
    for name, entries in documents.items():
        (base / name).write_text(yaml.safe_dump(entries, sort_keys=False))
    (base / "path.csv").write_text("x,y,right,left\n0,0,1,1\n2,0,1,1\n4,1,1,1\n6,1,1,1\n")
    image.save(base / "height.png")
    TerrainMap.from_arrays(np.zeros((6, 8)), np.zeros((6, 8)), 0.5).save(base / "terrain.npz")


def write_bag(base: Path) -> None:
    """Write a bag with a scan and an odometry; needs rosbags."""
    from types import SimpleNamespace as Fields

    stamp = Fields(sec=1_700_000_000, nanosec=0)
    header = Fields(stamp=stamp, frame_id="laser")
    scan = Fields(
        header=header,
        angle_min=-1.0,
        angle_max=1.0,
        angle_increment=0.5,
        time_increment=0.0,
        scan_time=0.1,
        range_min=0.1,
        range_max=5.0,
        ranges=np.ones(5, np.float32),
        intensities=np.zeros(0, np.float32),
    )
    zero = Fields(x=0.0, y=0.0, z=0.0)
    pose = Fields(position=zero, orientation=Fields(x=0.0, y=0.0, z=0.0, w=1.0))
    odometry = Fields(
        header=header,
        child_frame_id="base_link",
        pose=Fields(pose=pose, covariance=np.zeros(36)),
        twist=Fields(twist=Fields(linear=zero, angular=zero), covariance=np.zeros(36)),
    )
    with BagWriter(base / "bag") as writer:
        for number in range(20):
            now = 1_700_000_000.0 + 0.1 * number
            writer.write("/odom", "Odometry", odometry, now)
            writer.write("/scan", "LaserScan", scan, now)


def write_kept(base: Path) -> None:
    """Write a run folder, a study and a comparison, as the commands write them.

    The run is a real one. The episodes of the others are not simulated.
    """
    run = ["run", "room.yaml", "--time-limit", "0.1", "--no-animation", "--out", "run"]
    with (
        contextlib.chdir(base),
        open(os.devnull, "w") as nowhere,
        contextlib.redirect_stdout(nowhere),
        contextlib.redirect_stderr(nowhere),
    ):
        main([*run, *FEW])
        with mock.patch.object(Runner, "run", _runner_of(Run.load("run"))):
            for command in (STUDY, COMPARISON):
                main(filled(command, base))


def filled(arguments: Sequence[str], base: Path) -> list[str]:
    """Return arguments with the folder of the valid files for `{base}`."""
    return [each.replace("{base}", str(base)) for each in arguments]


def _runner_of(run: Run) -> Callable[..., None]:
    """Return a runner that reports the results of one run for every task."""
    recording, metrics = run.recording, run.metrics
    assert isinstance(recording, ExplorationRecording)
    assert isinstance(metrics, ExplorationMetrics)
    chance = random.Random(0)

    def report(_: Runner, tasks: Sequence[Any], on_result: Callable[..., None]) -> None:
        for task in tasks:
            if isinstance(task, RowTask):
                settings = make_exploration_settings({"map": "office"})
                rows = [make_row(e, recording, metrics, settings=settings) for e in task.episodes]
                on_result(task, [store_row(row) for row in rows])
            else:
                assert isinstance(task, MetricsTask)
                found = with_late_times(flat(metrics.as_dict()), 1.0)
                result = Result(found | {"time_to.99": chance.random()})
                on_result(task, [result] * len(task.episodes))

    return report
