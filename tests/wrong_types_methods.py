"""Call public methods with wrong types, for `wrong_types_program.py`."""

import traceback
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxplore as jx
from jaxplore import control, dynamics, planning, simulation

UNTRACED = {
    "animate",
    "load",
    "save",
    "at_period",
    "at_pose",
    "from_ros",
    "pad",
    "plot",
    "crop",
    "resample",
    "to_ros",
    "unknown",
    "with_room",
    "at_headings",
}
"""Methods that run on the host."""


WRONG = {"text": "wrong", "object": object(), "list": [object()], "None": None, "class": dict}


def outcome(call: Callable[..., Any], name: str, arguments: dict[str, Any]) -> str | None:
    """Return what is wrong with the error of a call: None if nothing is."""
    try:
        call(**arguments)
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        is_ours = last.filename.startswith(str(Path(jx.__file__).parent))
        if is_ours and isinstance(error, (ValueError, TypeError)) and name in str(error):
            return None
        return f"{type(error).__name__} in {last.filename}:{last.lineno}: {str(error)[:200]}"
    return "accepted"


def traced(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a method that is traced, so that nothing is compiled; as it is on the host."""
    if method.__name__ in UNTRACED:
        return method

    def traced(**arguments: Any) -> Any:
        return eqx.filter_eval_shape(method, **arguments)

    return traced


def methods(
    folder: Path, own: dict[str, dict[str, Any]]
) -> dict[str, tuple[Callable[..., Any], dict[str, Any]]]:
    """Return public methods with accepted arguments, by name.

    Args:
        folder: folder for the files that some of them read and write.
        own: accepted arguments of constructors.
    """
    robot, key, number = jx.DifferentialDrive(), jax.random.key(0), jnp.array(0.1)
    lidar = jx.Lidar(num_beams=8, max_range=2.0)
    grid = jx.OccupancyGrid(np.pad(np.zeros((10, 10)), 1, constant_values=1.0), 0.5)
    pose, point = jnp.array([2.0, 2.0, 0.0]), jnp.array([2.0, 2.0])
    scenario = jx.ExplorationScenario(grid, robot, lidar, (2.0, 2.0, 0.0))
    perception, path = scenario.perception, jx.path_through([[0.0, 0.0], [2.0, 0.0], [4.0, 1.0]])
    known = eqx.filter_eval_shape(perception.init, grid, pose)
    # Every method but those of controllers runs for all its arguments without compiling anything.
    known = jax.tree.map(lambda leaf: jax.device_put(np.zeros(leaf.shape, leaf.dtype)), known)
    few: dict[str, Any] = {"horizon": 4, "num_samples": 8}
    mppi = jx.MPPI(robot, jx.GoalCost([1.0, 2.0]), noise_std=[1.0, 1.0], **few)
    controllers: dict[str, control.Controller] = {
        "MPPI": mppi,
        "FeedbackMPPI": jx.FeedbackMPPI(mppi),
        "LatencyCompensation": jx.LatencyCompensation(mppi, 0.1),
        "Portfolio": planning.Portfolio(mppi, **own["Portfolio"]),
        "TargetExplorer": planning.TargetExplorer(**own["TargetExplorer"]),
        "InformativeMPPI": jx.informative_mppi(jx.Quadrotor(), resolution=0.5),
        "explorer": jx.explorer(robot, **few),
        "RandomWalk": planning.random_walk(jx.Quadrotor()),
    }
    found: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {}
    for name, each in controllers.items():
        size = 5 if name not in ("InformativeMPPI", "RandomWalk") else 13
        given = {"state": each.init(), "observation": jnp.zeros(size), "key": key}
        if name in ("TargetExplorer", "InformativeMPPI", "RandomWalk", "explorer"):
            given["belief"] = known  # the others' costs read none
        found[f"{name}.step"] = each.step, given
        # The others hand the number to their MPPI, after much that would be traced first.
        number_too = {"num_trajectories": 2} if name in ("MPPI", "Portfolio") else {}
        found[f"{name}.inspect"] = each.inspect, given | number_too
        found[f"{name}.at_period"] = each.at_period, {"control_period": 0.1}
    scan = lidar.scan(grid, pose, key=key)
    camera = jx.Camera(8, 2.0)
    for name, sensor in (("Lidar", lidar), ("Camera", camera)):
        sight = {"grid": grid, "scan": scan, "pose": pose}
        found[f"{name}.scan"] = (
            sensor.scan,
            {"world": grid, "pose": pose, "key": key, "movers": np.zeros((1, 3))},
        )
        found[f"{name}.sight"] = sensor.sight, {**sight, "ground": None}
        found[f"{name}.update"] = (
            sensor.update,
            {"belief": grid, "scan": scan, "pose": pose, "model": perception.sensor_model},
        )
        found[f"{name}.sees"] = sensor.sees, {"world": grid, "pose": pose, "points": point[None]}
    for model in (
        robot,
        jx.Unicycle(),
        jx.Ackermann(),
        jx.KinematicBicycle(0.3),
        jx.PointMass(2),
        jx.Omnidirectional(),
        jx.Quadrotor(),
        dynamics.Pendulum(),
    ):
        name = type(model).__name__
        state, command = jnp.zeros(model.state_size), jnp.zeros(model.control_size)
        found[f"{name}.step"] = model.step, {"state": state, "control": command, "dt": number}
        if not isinstance(model, dynamics.Pendulum):
            found[f"{name}.at_pose"] = model.at_pose, {"x": 1.0, "y": 1.0, "yaw": 0.0}
    cells = jnp.zeros((1, 2), jnp.int32)
    found |= {
        "MPPI.init": (mppi.init, {"controls": jnp.zeros((4, 2))}),
        "Perception.init": (perception.init, {"grid": grid, "pose": pose}),
        "Perception.observe": (
            perception.observe,
            {"belief": known, "scans": scan, "pose": pose, "elapsed": 0.1},
        ),
        "Perception.update_fields": (
            perception.update_fields,
            {"belief": known, "pose": pose, "elapsed": number},
        ),
        "InformationField.call": (
            known.information.__call__,
            {"position": point, "heading": number, "field_of_view": 1.0},
        ),
        "InformationField.plot": (known.information.plot, {"heading": 0.1}),
        "InformationField.at_headings": (
            known.information.at_headings,
            {"num_headings": 4, "field_of_view": 1.0},
        ),
        "OccupancyGrid.at": (grid.at, {"points": point[None]}),
        "OccupancyGrid.at_cell": (grid.at_cell, {"cell": cells}),
        "OccupancyGrid.contains": (grid.contains, {"cell": cells}),
        "OccupancyGrid.interpolate": (grid.interpolate, {"position": point}),
        "OccupancyGrid.with_probability": (
            grid.with_probability,
            {"probability": grid.probability},
        ),
        "OccupancyGrid.with_prior": (grid.with_prior, {"prior": number}),
        "OccupancyGrid.pad": (grid.pad, {"shape": (32, 32)}),
        "OccupancyGrid.crop": (grid.crop, {"values": grid.probability}),
        "OccupancyGrid.resample": (grid.resample, {"resolution": 0.5}),
        "OccupancyGrid.unknown": (grid.unknown, {"shape": (4, 4), "frame": grid.frame}),
        "OccupancyGrid.to_ros": (
            grid.to_ros,
            {"path": str(folder / "map.yaml"), "mode": "trinary"},
        ),
        "OccupancyGrid.from_ros": (grid.from_ros, {"path": str(folder / "map.yaml")}),
        "Path.at": (path.at, {"phi": number}),
        "Path.room": (path.with_room((1.0, 1.0)).room, {"phi": number}),
        "Path.with_room": (path.with_room, {"half_widths": (1.0, 1.0)}),
        "Path.errors": (path.errors, {"position": point, "phi": number}),
        "Path.offset": (path.offset, {"phi": number, "lateral": number}),
        "Path.nearest": (path.nearest, {"position": point, "near": number}),
    }
    unfinished: Any = types.SimpleNamespace(figures=dict)  # the recording is not reached
    run = simulation.Run(unfinished, unfinished)
    refused = {"path": "run", "overwrite": True, "animation": False, "film": None}
    found |= {
        "Run.plot": (run.plot, {"name": "map"}),
        "Run.animate": (run.animate, {"path": "film.gif", "fps": 1, "scale": 1, "progress": False}),
        "Run.save": (run.save, {**refused, "figures": "png", "settings": None, "progress": False}),
        "Run.load": (run.load, {"path": "run"}),
    }
    return found
