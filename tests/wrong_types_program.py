"""Make the mistakes of the first hour, and call everything public with wrong types.

A program of its own: in the tests beartype checks the types of all calls before our code does.
Prints JSON: what becomes of each mistake, and of each call that is not refused as it should be.
"""

import inspect
import json
import sys
import types
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxplore as jx
from jaxplore import (
    belief,
    control,
    costs,
    dynamics,
    geometry,
    information,
    localisation,
    maps,
    parts,
    planning,
    sensing,
    simulation,
)
from wrong_types_bounds import bounds
from wrong_types_methods import WRONG, methods, outcome, traced

PACKAGES = (jx, belief, control, costs, dynamics, geometry, information, maps, planning, sensing)
PACKAGES += (parts, simulation, localisation)

RECORDS = {
    "Anomalies",
    "AgentView",
    "Belief",
    "ChunkedRun",
    "ControlSpace",
    "Detections",
    "EndPoints",
    "EnvironmentState",
    "Experiment",
    "FleetBelief",
    "InformationField",
    "LikelihoodField",
    "HeadingField",
    "Metrics",
    "ObjectClasses",
    "Outlines",
    "PoseState",
    "Recording",
    "Run",
    "SamplingContext",
    "Stability",
    "Stance",
    "ScalarField",
    "State",
    "StrategicBelief",
    "SumCost",
    "SurfaceMap",
    "VolumePoints",
    "VolumeSurface",
    "TargetScores",
    "TerrainMap",
    "VolumeBelief",
    "VolumeStrategicBelief",
    "GuidanceField",
    "WayPoints",
    "WeightedCost",
}
"""Classes whose objects the library makes: a user reads them, and calls no constructor."""

INNER = {
    "cell_gains",
    "cell_information",
    "beam_information",
    "cauchy_schwarz_information",
    "clearance_field",
    "diversity",
    "entropy_proxy",
    "expected_gain",
    "path_headings",
    "pose_table",
    "predict_state",
    "step_with_gains",
    "rollout",
    "rollout_costs",
    "rollout_objectives",
    "sin_cos",
    "update_gain",
    "visible",
}
"""Functions that are called in traced code, where nothing may be checked."""

RUNNING = {"compare", "map_log", "optimise", "record_runs", "simulate", "simulate_in_parts"}
"""Functions that compile and run a loop if nothing is wrong. Then their own tests do."""


SLOW = {
    "MPPI.inspect",
    "NoiseBank",
    "Portfolio.inspect",
    "VolumePerception.num_elevations",
    "VolumePerception.num_sectors",
    "explorer",
    "ground_portfolio",
    "informative_mppi",
    "mpcc",
    "volume_explorer",
    "volume_informative_mppi",
    "volume_target_explorer",
}
"""Calls that take long with numbers at their bounds: only what is refused is tried."""


def everything() -> dict[str, Callable[..., Any]]:
    """Return the public constructors and functions that take arguments, by name."""
    found: dict[str, Callable[..., Any]] = {}
    for package in PACKAGES:
        for name in dir(package):
            value = getattr(package, name)
            if name.startswith("_") or isinstance(value, types.ModuleType) or not callable(value):
                continue
            if not getattr(value, "__module__", "").startswith("jaxplore"):
                continue
            signature = inspect.signature(value).parameters
            is_record = isinstance(value, type) and issubclass(value, tuple)
            if is_record or inspect.isabstract(value) or name in RECORDS | INNER:
                continue
            if any(each.kind != each.VAR_POSITIONAL for each in signature.values()):
                is_other = found.get(name, value) is not value
                room = package.__name__.removeprefix("jaxplore.")
                found[f"{room}.{name}" if is_other else name] = value
    return found


def examples(folder: Path) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Return an accepted value of each parameter without a default, for all and for some calls.

    Args:
        folder: folder for the files that some calls read and write.
    """
    (folder / "path.csv").write_text("x,y\n0,0\n2,0\n4,1\n")
    jx.OccupancyGrid(np.zeros((2, 3)), 0.5).to_ros(folder / "map.yaml")
    scan = " ".join(["FLASER 180", *["1.0"] * 180, "0 0 0 0 0 0 1.0 host 1.0"])
    (folder / "lidar.log").write_text(scan)
    robot = jx.DifferentialDrive()
    lidar = jx.Lidar(num_beams=8, max_range=2.0)
    grid = jx.OccupancyGrid(np.pad(np.zeros((10, 10)), 1, constant_values=1.0), 0.5)
    cost = jx.GoalCost([1.0, 2.0])
    mppi = jx.MPPI(robot, cost, horizon=4, num_samples=8, noise_std=[1.0, 2.0])
    path = jx.path_through([[0.0, 0.0], [2.0, 0.0], [4.0, 1.0]])
    scenario = jx.ExplorationScenario(grid, robot, lidar, (2.0, 2.0, 0.0))
    zones = belief.Zones(np.ones((1, 2, 2), bool))
    targets = planning.Targets(zones, (1.0, 1.0))
    pose = jx.PoseInformation(lidar)
    quadrotor = jx.Quadrotor()
    volume = jx.VoxelGrid.solid(np.pad(np.zeros((6, 6, 6), bool), 1, constant_values=True), 0.5)
    np.save(folder / "volume.npy", np.asarray(volume.is_occupied))
    camera = jx.DepthCamera(4, 3)
    seen = jx.VolumePerception([camera], 0.5, 0.3)
    virtual = jx.PathParameter(1.0)
    physical_proposal = jx.GaussianProposal([1.0, 2.0])
    common: dict[str, Any] = {
        "robot": robot,
        "dynamics": robot,
        "model": jx.Augmented(robot, virtual),
        "physical": robot,
        "virtual": virtual,
        "physical_proposal": physical_proposal,
        "virtual_proposal": physical_proposal,
        "cost": cost,
        "sensors": lidar,
        "lidar": lidar,
        "sensor": jx.PoseInformation(lidar),
        "pose": pose,
        "world": grid,
        "grid": grid,
        "start": (2.0, 2.0, 0.0),
        "end": (3.0, 3.0),
        "resolution": 0.5,
        "path": path,
        "mppi": mppi,
        "planner": mppi,
        "controller": mppi,
        "scenario": scenario,
        "scenarios": scenario,
        "num_steps": 1,
        "key": jax.random.key(0),
        "keys": jax.random.split(jax.random.key(0), 1),
        "proposal": physical_proposal,
        "noise_std": [1.0, 2.0],
        "std": 0.1,
        "goal": (1.0, 1.0),
        "waypoint": (1.0, 1.0),
        "weights": {"x": 1.0},
        "centres": [[1.0, 1.0]],
        "radii": [0.5],
        "radius": 0.5,
        "turning_radius": 0.5,
        "footprint": geometry.Disc(0.2),
        "chassis": geometry.Chassis(0.5, 0.4),
        "points": [[0.0, 0.0], [1.0, 1.0]],
        "reference": np.zeros((4, 5), np.float32),
        "limit": 1.0,
        "zones": zones,
        "targets": targets,
        "name": "name",
        "names": ("name",),
        "temperature": 0.1,
        "period": 0.1,
    }
    corners = [[-0.5, -0.5], [0.5, -0.5], [0.0, 0.5]]
    flying = jx.informative_mppi(quadrotor, resolution=0.5)
    wide = jx.path_through([[0.0, 0.0], [2.0, 0.0], [4.0, 1.0]], half_widths=(1.0, 1.0))
    following = jx.mpcc(robot, wide, horizon=4, num_samples=8)
    certainty = belief.CertaintyField(scenario.sensors[0], 0.5)
    uncertain = dynamics.UncertainRobot(robot, certainty.blank())
    aware = jx.explorer(robot, uncertain=uncertain, horizon=4, num_samples=8)
    own: dict[str, dict[str, Any]] = {
        "AdaptiveSoftmax": {"effective_sample_size": 10.0},
        "AugmentedProposal": {"physical": physical_proposal, "virtual": jx.GaussianProposal([1.0])},
        "ControlNoise": {"std": [0.1, 0.1]},
        "Chassis": {"wheelbase": 0.5, "track": 0.4},
        "CorridorCost": {"path": wide},
        "Detector": {"classes": ("a", "b"), "confusion": [[0.9, 0.1], [0.2, 0.8]]},
        "Environment": {"mode": simulation.ControlMode(robot)},
        "FieldSensor": {"num_directions": 8},
        "Flight": {},
        "GaussianProposal": {"noise_std": [1.0]},
        "Ground": {"elevation": np.zeros((4, 4))},
        "InformativeMPPI": {
            "mppi": jx.informative_mppi(quadrotor, "parallel", resolution=0.5).mppi,
            "potential_sensor": flying.potential_sensor,
            "short_range_field": flying.short_range_field,
            "sensor_model": flying.sensor_model,
        },
        "InjectedProposal": {"null_action": True},
        "Knots": {"num_knots": 3},
        "LatencyCompensation": {"latency": 0.1},
        "LabelledObject": {"position": (1.0, 1.0), "label": "a"},
        "MPPI": {"noise_std": [1.0, 2.0]},
        "MovingObstacle": {"path": ((1.0, 1.0), (2.0, 1.0)), "speed": 1.0},
        "MovingObstacles": {"movers": [jx.MovingObstacle(((1.0, 1.0), (2.0, 1.0)), 1.0, 0.2)]},
        "NoiseBank": {"size": 64},
        "Obstacles": {"outlines": geometry.Outlines.discs([[1.0, 1.0]], [0.5])},
        "OccupancyGrid": {"probability": np.zeros((4, 4))},
        "Outlines": {"corners": [corners]},
        "Path": {
            "position": lambda phi: np.stack([phi, 0.0 * phi], -1),
            "direction": lambda phi: np.stack([1.0 + 0.0 * phi, 0.0 * phi], -1),
            "length": 2.0,
        },
        "PathParameter": {"max_rate": 1.0},
        "PathScenario": {"robot": following.model, "path": wide},
        "Perception": {"robot_radius": 0.2},
        "Portfolio": {
            "objectives": {"goal": cost, "effort": jx.ControlCost()},
            "weights": [[1.0, 1.0], [2.0, 0.0]],
        },
        "PoseInformation": {},
        "QuadraticControlCost": {"weights": [1.0, 1.0]},
        "target_explorer": {"rule": "nearest-frontier", "perception": scenario.perception},
        "KeepOut": {"areas": [[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]]},
        "Objects": {},
        "parts.Targets": {"places": [[1.0, 1.0]]},
        "Battery": {"dock": (1.0, 1.0)},
        "TrueBattery": {"battery": jx.parts.Battery((1.0, 1.0))},
        "PlantedAnomalies": {"boxes": [(0.0, 0.0, 1.0, 1.0)], "kinds": [1]},
        "Wheels": {"chassis": geometry.Chassis(0.5, 0.4, 0.3)},
        "Recognition": {"detector": sensing.Detector(("a", "b"), [[0.9, 0.1], [0.2, 0.8]])},
        "Rectangle": {"front": 0.5, "rear": 0.5, "width": 0.5},
        "ReferenceCost": {"reference": np.zeros((4, 2)), "period": 0.1},
        "ShortRangeField": {
            "sensor": flying.short_range_field.sensor,
            "num_nodes": 8,
            "num_headings": 4,
        },
        "Fleet": {"robots": scenario, "starts": [(2.0, 2.0, 0.0)]},
        "FleetController": {"controllers": [mppi], "formation": dynamics.Formation([robot])},
        "Formation": {"robots": [robot]},
        "CertaintyField": {"sensor": scenario.sensors[0]},
        "UncertainRobot": {"physical": robot, "certainty": certainty.blank()},
        "UncertaintyAware": {"controller": aware},
        "near_starts": {"scenario": scenario, "number": 1},
        "walking_people": {"world": jx.office(), "number": 1},
        "StabilityCost": {"limit": 0.5},
        "StopCost": {"path": jx.geometry.line_path([0.0, 0.0], [2.0, 0.0])},
        "StateBoundsCost": {"lower": {"v": 0.0}},
        "StateNoise": {"std": [0.1] * 5},
        "TargetExplorer": {
            "tracker": mppi,
            "rule": planning.NearestFrontier(),
            "frame": grid.frame,
            "shape": grid.shape,
            "stride": 1,
            "required_clearance": 0.3,
            "min_information": 1.0,
            "every": 5,
        },
        "AdaptiveHorizon": {"rule": control.HorizonBySpeed(), "min_horizon": 2},
        "TargetReference": {"choice": planning.RemainingInformation(targets)},
        "ToeplitzNoise": {"weights": [0.2, 0.6, 0.2]},
        "Traffic": {"path": wide, "phi": [3.0], "offsets": [0.0], "rates": [1.0], "radii": [0.2]},
        "TrajectoryChoice": {"information": jx.TrajectoryInformation(pose)},
        "KeepOutBoxes": {"boxes": [[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]]},
        "GoalApproach": {
            "flying": jx.volume_explorer(quadrotor, has_goal=True),
            "dynamics": quadrotor,
        },
        "VolumeInformativeMPPI": {
            "mppi": jx.volume_explorer(quadrotor),
            "perception": seen,
            "grid": volume,
        },
        "VolumePerception": {"sensors": [camera]},
        "VolumeScenario": {
            "world": volume,
            "robot": quadrotor,
            "sensors": camera,
            "start": (2.0, 2.0, 2.0, 0.0),
        },
        "VolumeTargetExplorer": {
            "tracker": jx.volume_explorer(quadrotor),
            "rule": planning.NearestFrontier(),
            "perception": seen,
            "grid": volume,
            "min_information": 0.2,
            "min_frontier": 0.4,
            "near": 0.4,
            "every": 5,
        },
        "VoxelGrid": {"log_odds": np.zeros((2, 3, 4))},
        "WaypointMode": {"drive": mppi},
        "World": {"size": (5.0, 5.0), "start": (1.0, 1.0, 0.0)},
        "Zones": {"member": np.ones((1, 4, 4), bool)},
        "arc_path": {"angle": 1.0},
        "augmented_mppi": {"virtual_proposal": jx.GaussianProposal([1.0])},
        "compare": {"experiments": {"one": (mppi, scenario, 1)}, "seeds": [0]},
        "simulate_in_parts": {
            "controller": control.FleetController([mppi], dynamics.Formation([robot])),
            "fleet": jx.Fleet(scenario, [(2.0, 2.0, 0.0)]),
            "num_steps": 1,
            "workers": 1,
        },
        "enable_compilation_cache": {"path": str(folder / "programs")},
        "clothoid_path": {"pieces": [(1.0, 0.0, 0.5)]},
        "find_parameter": {"path": "temperature"},
        "fuse_actions": {"actions": np.ones((2, 2)), "costs": np.ones(2)},
        "fusion_by_name": {"name": "median"},
        "generate_map": {"kind": "open"},
        "generate_volume": {"kind": "forest"},
        "line_path": {"start": (0.0, 0.0)},
        "read_path": {"path": str(folder / "path.csv")},
        "optimise": {"graph": localisation.Graph(*[np.zeros((0, 3))] * 6)},
        "path_datum": {"path": str(folder / "path.csv")},
        "map_log": {"log": jx.sensing.read_laser_log(folder / "lidar.log")},
        "match_maps": {"one": grid, "other": grid},
        "unite_maps": {"one": grid, "other": grid, "pose": [0.0, 0.0, 0.0]},
        "map_datum": {"path": str(folder / "map.yaml")},
        "relative_world": {"world": jx.maps.three_zones(), "datum": jx.maps.Datum()},
        "read_laser_log": {"path": str(folder / "lidar.log")},
        "read_volume": {"path": str(folder / "volume.npy")},
        "volume_datum": {"path": str(folder / "volume.npy")},
        "volume_explorer": {"robot": quadrotor},
        "volume_informative_mppi": {"robot": quadrotor, "perception": seen, "grid": volume},
        "volume_target_explorer": {
            "robot": quadrotor,
            "rule": "nearest-cluster",
            "perception": seen,
            "grid": volume,
        },
        "set_parameters": {"values": {"temperature": 0.2}},
        "step_with_gains": {"state": mppi.init(), "observation": jnp.zeros(5)},
    }
    return common, own


def numbers() -> dict[str, Any]:
    """Return accepted numbers of arguments whose default is none, or of another shape."""
    return {
        "AnomalyTest.forbidden": [[0.0, 0.0, 1.0, 1.0]],
        "Contextual.goal": [1.0, 1.0],
        "ExplorationScenario.goal": [3.0, 3.0],
        "ExplorationScenario.tracking_noise": [0.1, 0.1],
        "Faults.carried_to": [1.0, 1.0, 0.0],
        "GaussianProposal.mean": [0.0],
        "InjectedProposal.sequences": np.zeros((1, 4, 2)).tolist(),
        "MovingObstacles.phase": [0.0],
        "PathScenario.start": [0.0, 0.0, 0.0],
        "Perception.goal": [3.0, 3.0],
        "Obstacles.centres": [[0.0, 0.0]],
        "Obstacles.covariance": [[0.1, 0.0], [0.0, 0.1]],
        "Obstacles.velocities": [[0.0, 0.0]],
        "Portfolio.floors": [1.0, 1.0],
        "Portfolio.horizons": [4, 4],
        "Portfolio.noise_scales": [1.0, 1.0],
        "Portfolio.temperatures": [1.0, 1.0],
        "QuadraticControlCost.target": [0.0, 0.0],
        "Recognition.prior": [0.5, 0.5],
        "Shapes.discs": [[1.0, 1.0, 0.5]],
        "Shapes.rectangles": [[0.0, 0.0, 1.0, 1.0]],
        "Shapes.walls": [[0.0, 0.0, 1.0, 1.0]],
        "StateBoundsCost.scale": {"v": 1.0},
        "StateBoundsCost.upper": {"v": 1.0},
        "StateCost.target": {"x": 1.0},
        "KeepOutBoxes.boxes": [[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]],
        "VolumePerception.goal": [2.6, 2.0, 2.0],
        "VolumePerception.window": [8.0, 8.0, 4.0],
        "VolumeScenario.goal": [2.6, 2.0, 2.0],
        "World.forbidden": [[3.0, 3.0, 4.0, 4.0]],
        "World.goal": [4.0, 4.0],
        "World.hills": [[3.0, 3.0, 0.1, 2.0]],
        "World.targets": [[4.0, 4.0]],
        "World.zones": [[3.0, 3.0, 4.0, 4.0]],
        "explorer.noise_std": [1.0, 1.0],
        "informative_mppi.goal": [1.0, 1.0, 1.0],
        "mpcc.noise_std": [1.0, 1.0, 1.0],
        "waypoint_mppi.noise_std": [1.0, 1.0],
    }


def walk(folder: Path) -> tuple[dict[str, str], dict[str, str]]:
    """Return each call that ends in another way than it should, and the bounds of arguments."""
    common, own = examples(folder)
    wrong, found = {}, {}
    more = numbers()
    calls = [
        (label, traced(method), given, inspect.signature(method).parameters, list(given))
        for label, (method, given) in methods(folder, own).items()
    ]
    for label, call in everything().items():
        parameters = {
            name: each
            for name, each in inspect.signature(call).parameters.items()
            if each.kind not in (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
        }
        given = own.get(label, {})
        needed = {
            name: given.get(name, common.get(name))
            for name, each in parameters.items()
            if each.default is each.empty or name in given
        }
        calls.append((label, call, needed, parameters, list(parameters)))
    for label, call, given, parameters, names in calls:
        try:
            # An unfinished run has nothing to save. To trace the step of a controller takes half a
            # second; the tests of each do.
            is_step = label.endswith((".step", ".inspect")) and "observation" in given
            if label not in RUNNING and not label.startswith("Run.") and not is_step:
                call(**given)
        except Exception as error:
            wrong[label] = f"the example is refused: {error!r}"
            continue
        for name in names:
            default = parameters[name].default
            for kind, value in WRONG.items():
                if value is default:
                    continue
                said = outcome(call, name, given | {name: value})
                if said is not None:
                    wrong[f"{label}({name}={kind})"] = said
            value = given.get(name, more.get(f"{label}.{name}", default))
            is_slow = bool({label, f"{label}.{name}"} & (RUNNING | SLOW))
            lines = bounds(call, given, name, value, is_slow=is_slow)
            found |= {f"{label}.{name}{place}": line for place, line in lines.items()}
    return wrong, found


class WithoutAnnotations(jx.Dynamics):
    state_names = control_names = ("x", "y")

    def __init__(self) -> None:
        self.control_min, self.control_max = -jnp.ones(2), jnp.ones(2)
        self.radius = jnp.array(0.2)

    def step(self, state: Any, control: Any, dt: Any) -> Any:
        return state + control * dt


class WithList(jx.Dynamics):
    state_names = control_names = ("x", "y")
    control_min: Any
    control_max: jax.Array
    radius: jax.Array

    def __init__(self, control_min: Any) -> None:
        self.control_min, self.control_max = control_min, jnp.ones(2)
        self.radius = jnp.array(0.2)

    def step(self, state: Any, control: Any, dt: Any) -> Any:
        return [state[0], state[1]]


class WithTuple(WithList):
    def step(self, state: Any, control: Any, dt: Any) -> Any:
        return state[0], state[1]


class WithoutNames(WithList):
    state_names = "xy"


class Height(jx.Cost):
    def stage(self, state: Any, control: Any, t: Any, belief: Any) -> Any:
        return belief.height


def mistakes() -> dict[str, Callable[[], Any]]:
    """Return what users do in their first hour, by name."""
    robot, cost, key = jx.DifferentialDrive(), jx.GoalCost([1.0, 2.0]), jax.random.key(0)
    lidar = jx.Lidar(num_beams=8, max_range=2.0)
    grid = jx.OccupancyGrid(np.pad(np.zeros((10, 10)), 1, constant_values=1.0), 0.5)
    start = (2.0, 2.0, 0.0)
    scenario = jx.ExplorationScenario(grid, robot, lidar, start)
    few: dict[str, Any] = {"horizon": 4, "num_samples": 8}
    noisy: dict[str, Any] = few | {"noise_std": [1.0, 1.0]}
    mppi = jx.MPPI(robot, cost, **noisy)
    state, at = mppi.init(), jnp.zeros(5)
    explorer, wants = jx.explorer(robot, **few), jx.MPPI(robot, Height(), **noisy)
    return {
        "a list of costs": lambda: jx.MPPI(robot, [cost, cost], **noisy),
        "a function as cost": lambda: jx.MPPI(robot, lambda x, u: 0.0, **noisy),
        "a number as cost": lambda: jx.MPPI(robot, 3.0, **noisy),
        "a class as cost": lambda: jx.MPPI(robot, jx.ControlCost, **noisy),
        "the sum of a list": lambda: jx.MPPI(robot, sum([cost, 2.0 * cost]), **noisy),
        "cost + 3": lambda: cost + 3,
        "3 + cost": lambda: 3 + cost,
        "a text times a cost": lambda: "2" * cost,
        "a cost times a cost": lambda: cost * cost,
        "a named list": lambda: jx.costs.NamedCost("name", [cost]),
        "a class as model": lambda: jx.MPPI(jx.DifferentialDrive, cost, **noisy),
        "swapped model and cost": lambda: jx.MPPI(cost, robot, **noisy),
        "swapped scenario and controller": lambda: jx.simulate(scenario, mppi, 1, key=key),
        "swapped steps and scenario": lambda: jx.simulate(mppi, 1, scenario, key=key),
        "swapped lidar and robot": lambda: jx.ExplorationScenario(grid, lidar, robot, start),
        "a class as sensor": lambda: jx.ExplorationScenario(grid, robot, jx.Lidar, start),
        "one of two sensors": lambda: jx.ExplorationScenario(grid, robot, [lidar, robot], start),
        "an array as world": lambda: jx.ExplorationScenario(np.zeros((9, 9)), robot, lidar, start),
        "the seed as key of simulate": lambda: jx.simulate(mppi, scenario, 1, key=0),
        "a folder to resume": lambda: jx.simulate(mppi, scenario, 1, key=key, resume="runs/1"),
        "the seed as key of step": lambda: mppi.step(state, at, key=0),
        "several keys": lambda: mppi.step(state, at, key=jax.random.split(key)),
        "a raw key": lambda: mppi.step(state, at, key=jax.random.PRNGKey(0)),
        "a list as state": lambda: mppi.step(state, [0.0, 0, 0, 0, 0], key=key),
        "a tuple as state": lambda: mppi.step(state, (0.0,) * 5, key=key),
        "float64 as state": lambda: mppi.step(state, np.zeros(5), key=key),
        "a short state": lambda: mppi.step(state, [0.0, 0.0, 0.0], key=key),
        "a short array as state": lambda: mppi.step(state, jnp.zeros(3), key=key),
        "a text as state": lambda: mppi.step(state, "here", key=key),
        "the robot's state as the controller's": lambda: mppi.step(at, at, key=key),
        "no belief": lambda: explorer.step(explorer.init(), at, key=key),
        "no belief for one's own cost": lambda: wants.step(wants.init(), at, key=key),
        "jax.jit": lambda: jax.jit(mppi.step)(state, at, key=key),
        "no annotations": WithoutAnnotations,
        "a list as bound": lambda: jx.MPPI(WithList([-1.0, -1.0]), cost, **noisy),
        "a step that returns a list": lambda: jx.MPPI(WithList(-jnp.ones(2)), cost, **noisy),
        "a step that returns a tuple": lambda: jx.MPPI(WithTuple(-jnp.ones(2)), cost, **noisy),
        "a text as names": lambda: WithoutNames(-jnp.ones(2)),
        "a text as horizon": lambda: jx.MPPI(robot, cost, horizon="30", noise_std=[1.0, 1.0]),
        "a text as speed": lambda: jx.DifferentialDrive(max_speed="1"),
        "None as speed": lambda: jx.DifferentialDrive(max_speed=None),
        "texts as noise": lambda: jx.MPPI(robot, cost, **few, noise_std=["1", "1"]),
        "NumPy integers": lambda: jx.MPPI(
            robot, cost, horizon=np.int64(4), num_samples=np.int32(8), noise_std=np.ones(2)
        ),
        "a yaw in degrees": lambda: jx.ExplorationScenario(grid, robot, lidar, (2.0, 2.0, 90.0)),
        "a view in degrees": lambda: jx.Lidar(field_of_view=90.0),
        "a radius in centimetres": lambda: jx.DifferentialDrive(radius=200.0),
        "a range in millimetres": lambda: jx.Lidar(max_range=5000.0),
        "a text as shape": lambda: grid.pad("40"),
        "one number as shape": lambda: grid.pad((40,)),
        "half a row": lambda: grid.pad((40.5, 60)),
        "fewer rows than there are": lambda: grid.pad((5, 60)),
    }


def message(call: Callable[[], Any]) -> str:
    """Return the class and the text of a call's error or warning, or "works"."""
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            call()
    except Exception as error:
        # JAX adds lines of its own to errors of traced code.
        return f"{type(error).__name__}: {str(error).split(chr(10) + '-----')[0]}"
    if not caught:
        return "works"
    is_here = all(each.filename == __file__ for each in caught)
    return f"{'' if is_here else 'elsewhere '}UserWarning: {caught[0].message}"


if __name__ == "__main__":
    # Of each of some thousand errors JAX would sort its own lines out.
    jax.config.update("jax_traceback_filtering", "off")
    said = {name: message(call) for name, call in mistakes().items()}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        wrong, found = walk(Path(sys.argv[1]))
    json.dump({"mistakes": said, "walk": wrong, "bounds": found}, sys.stdout, indent=1)
