"""`jaxplore import-nav2`: files in the format of nav2, written here."""

import copy
import math
from pathlib import Path

import pytest
import yaml

from jaxplore import DifferentialDrive, Omnidirectional
from jaxplore.cli import main
from jaxplore.ros.nav2 import read_nav2
from jaxplore.tasks.registry import build, make_settings

PLUGIN = "nav2_mppi_controller::MPPIController"
FOLLOW = {
    "plugin": PLUGIN,
    "time_steps": 40,
    "model_dt": 0.1,
    "batch_size": 800,
    "iteration_count": 2,
    "vx_std": 0.3,
    "wz_std": 0.5,
    "vx_max": 0.7,
    "vx_min": -0.2,
    "wz_max": 1.5,
    "ax_max": 2.0,
    "ax_min": -4.0,
    "az_max": 2.5,
    "temperature": 0.25,
    "gamma": 0.015,
    "motion_model": "DiffDrive",
    "critics": ["ConstraintCritic", "CostCritic", "GoalAngleCritic", "PathFollowCritic"],
    "CostCritic": {"enabled": True, "cost_weight": 7.62, "cost_power": 1, "critical_cost": 300.0},
    "GoalAngleCritic": {"cost_weight": 3.0, "symmetric_yaw_tolerance": True},
    "PathFollowCritic": {"cost_weight": 2.5, "cost_power": 2},
    "TwirlingCritic": {"cost_weight": 10.0},
    "TrajectoryVisualizer": {"time_step": 3},
    "wheel_colour": "red",
}
COSTMAP = {"robot_radius": 0.25, "inflation_layer": {"inflation_radius": 0.6}}
OLD_CRITICS = ["ObstaclesCritic", "PathAlignLegacyCritic", "PathAngleCritic", "GoalCritic"]


def parameters(follow=None, costmap=COSTMAP, *, frequency: float = 30.0, name: str = "FollowPath"):
    """A parameter file of nav2, with other values for its MPPI controller."""
    section = {**FOLLOW, **({} if follow is None else follow)}
    section = {key: value for key, value in section.items() if value is not None}
    server = {"controller_frequency": frequency, "controller_plugins": [name], name: section}
    return {
        "amcl": {"ros__parameters": {"robot_model_type": "differential"}},
        "controller_server": {"ros__parameters": server},
        "local_costmap": {"local_costmap": {"ros__parameters": costmap}},
    }


@pytest.fixture
def read(tmp_path: Path):
    """Return a reader of parameters, through a file."""

    def reader(tree, *arguments):
        file = tmp_path / "nav2_params.yaml"
        file.write_text(yaml.safe_dump(tree))
        return read_nav2(file, *arguments)

    return reader


def test_a_robot_with_two_wheels(read) -> None:
    found = read(parameters())
    # The mean square of a random walk of 40 steps of 0.1 s is that of nav2's noise.
    walk = 0.1 * math.sqrt(sum(range(1, 41)) / 40)
    assert found.entries == {
        "map": "office",
        "robot": {
            "model": "differential_drive",
            "max_speed": 0.7,
            "max_acceleration": 2.0,
            "max_deceleration": 4.0,
            "drag": 0.0,
            "max_turn_rate": 1.5,
            "max_angular_acceleration": 2.5,
            "radius": 0.25,
        },
        "controller": {
            "horizon": 40,
            "dt": 0.1,
            "num_samples": 800,
            "temperature": 0.25,
            "noise_std": pytest.approx([0.3 / walk, 0.5 / walk], abs=1e-6),
            # Weights keep their ratio to nav2's defaults, 3.81 and 5.
            "obstacle_weight": 2.0,
            "guidance_weight": 0.5,
            "clearance": 0.6,
        },
        "rates": {"control": 30.0, "sensing": 10.0, "fields": 5.0},
    }
    left_out = {each.name.removeprefix("FollowPath."): each.reason for each in found.left_out}
    assert set(left_out) == {
        "vx_min",
        "iteration_count",
        "gamma",
        "ConstraintCritic",
        "GoalAngleCritic",
        "TwirlingCritic",
        "CostCritic.critical_cost",
        "PathFollowCritic.cost_power",
        "TrajectoryVisualizer.time_step",
        "wheel_colour",
    }
    assert left_out["wheel_colour"] == "the parameter is not known"
    assert "is_symmetric" in left_out["GoalAngleCritic"]
    assert "not among critics" in left_out["TwirlingCritic"]
    experiment = build(make_settings(found.entries))
    assert isinstance(experiment.scenario.robot, DifferentialDrive)
    assert experiment.controller.horizon == 40


def test_an_omnidirectional_robot_with_old_critics(read) -> None:
    follow = {
        "motion_model": "mppi::OmniMotionModel",
        "vy_max": 0.4,
        "ay_max": 1.0,
        "critics": OLD_CRITICS,
        "ObstaclesCritic": {"repulsion_weight": 3.0, "inflation_radius": 0.8},
        "CostCritic": None,
    }
    corners = "[[0.3, 0.2], [0.3, -0.2], [-0.3, -0.2], [-0.3, 0.2]]"
    found = read(parameters(follow, {"footprint": corners}, frequency=25.0))
    robot = found.entries["robot"]
    assert robot["model"] == "omnidirectional"
    assert (robot["min_speed"], robot["max_lateral_speed"]) == (-0.2, 0.4)
    assert robot["radius"] == pytest.approx(math.hypot(0.3, 0.2), abs=1e-6)
    assert len(found.entries["controller"]["noise_std"]) == 3
    assert found.entries["controller"]["obstacle_weight"] == 2.0
    assert found.entries["controller"]["clearance"] == 0.8
    assert found.entries["rates"]["sensing"] == pytest.approx(25.0 / 3, abs=1e-6)
    names = {each.name.rpartition(".")[2] for each in found.left_out}
    assert {"ay_max", "PathAlignLegacyCritic", "PathAngleCritic", "GoalCritic"} <= names
    assert isinstance(build(make_settings(found.entries)).scenario.robot, Omnidirectional)


def test_a_car_along_a_path(read) -> None:
    follow = {
        "motion_model": "Ackermann",
        "AckermannConstraints": {"min_turning_r": 0.8},
        "critics": ["CostCritic", "PathAlignCritic", "PathFollowCritic", "PreferForwardCritic"],
        "PathAlignCritic": {"cost_weight": 20.0, "enabled": True},
        "PathFollowCritic": {"enabled": False},
    }
    found = read(parameters(follow, {"footprint": [[0.5, 0.2], [-0.1, -0.2]]}), "path")
    robot = found.entries["robot"]
    assert (robot["length"], robot["width"]) == (0.6, 0.4)
    assert robot["wheelbase"] < 0.6
    assert math.tan(robot["max_steering"]) == pytest.approx(robot["wheelbase"] / 0.8, rel=1e-5)
    assert found.entries["controller"]["contouring_weight"] == 20.0
    assert "progress_weight" not in found.entries["controller"]
    # A path without obstacles has no weight for them.
    assert "obstacles" not in found.entries
    assert ("obstacles.weight", "200 by nav2, for runs with obstacles") in found.left_out
    assert found.entries["control_rate"] == 30.0
    names = {each.name.rpartition(".")[2] for each in found.left_out}
    assert {"wz_max", "temperature", "PathFollowCritic", "PreferForwardCritic"} <= names
    build(make_settings(found.entries))


def test_a_motion_model_may_be_an_instance_with_a_plugin(read) -> None:
    wheels = {"motion_model": "wheels", "wheels": {"plugin": "mppi::DiffDriveMotionModel"}}
    plain, named = read(parameters()), read(parameters(wheels))
    assert named == plain
    turns = {"plugin": "mppi::AckermannMotionModel", "min_turning_r": 1.1}
    own = read(parameters({"motion_model": "my_car", "my_car": turns}))
    old = {"motion_model": "Ackermann", "AckermannConstraints": {"min_turning_r": 1.1}}
    assert own == read(parameters(old))
    assert own.entries["robot"]["model"] == "ackermann"


@pytest.mark.parametrize("is_nested", [False, True])
def test_mppi_inside_of_a_rotation_shim(read, is_nested: bool) -> None:
    plain, tree = read(parameters()), parameters()
    server = tree["controller_server"]["ros__parameters"]
    shim = {
        "plugin": "nav2_rotation_shim_controller::RotationShimController",
        "angular_dist_threshold": 0.785,
    }
    inner = server["FollowPath"]
    beside = {**inner, **shim, "primary_controller": PLUGIN}
    server["FollowPath"] = {**shim, "primary_controller": inner} if is_nested else beside
    found = read(tree)
    assert found.entries == plain.entries
    (of_shim,) = set(found.left_out) - set(plain.left_out)
    assert of_shim.name == "FollowPath.angular_dist_threshold"
    assert "turn on the spot" in of_shim.reason


def test_of_other_controllers_the_robot_and_the_rate_are_taken(read) -> None:
    tree = parameters(
        {
            **dict.fromkeys(FOLLOW),
            "plugin": "dwb_core::DWBLocalPlanner",
            "max_vel_x": 0.26,
            "max_vel_theta": 1.1,
            "acc_lim_x": 2.5,
            "decel_lim_x": -2.0,
            "critics": ["RotateToGoal", "Oscillation"],
        }
    )
    found = read(tree)
    robot = {
        "model": "differential_drive",
        "max_speed": 0.26,
        "max_turn_rate": 1.1,
        "max_acceleration": 2.5,
        "max_deceleration": 2.0,
        "radius": 0.25,
    }
    assert found.entries["robot"] == robot
    assert found.entries["rates"]["control"] == 30.0
    (left,) = found.left_out
    assert left.name == "FollowPath"
    assert "another controller than MPPI" in left.reason
    build(make_settings(found.entries))
    # What the controller does not bound, the velocity smoother does.
    tree["controller_server"]["ros__parameters"]["FollowPath"] = {
        "plugin": "nav2_regulated_pure_pursuit_controller::RegulatedPurePursuitController",
        "desired_linear_vel": 0.5,
    }
    limits = {
        "max_velocity": [0.4, 0.0, 1.2],
        "max_accel": [1.5, 0.0, 2.2],
        "max_decel": [-1.8, 0.0, -3.0],
    }
    tree["velocity_smoother"] = {"ros__parameters": limits}
    assert read(tree).entries["robot"] == {
        "model": "differential_drive",
        "max_speed": 0.5,
        "max_turn_rate": 1.2,
        "max_acceleration": 1.5,
        "max_deceleration": 1.8,
        "max_angular_acceleration": 2.2,
        "radius": 0.25,
    }


def test_mppi_is_taken_before_another_controller(read) -> None:
    tree = parameters()
    server = tree["controller_server"]["ros__parameters"]
    server["controller_plugins"] = ["Other", "FollowPath"]
    server["Other"] = {"plugin": "dwb_core::DWBLocalPlanner", "max_vel_x": 0.1}
    assert read(tree) == read(parameters())
    other = read(tree, "exploration", "Other")
    assert other.entries["robot"]["max_speed"] == 0.1


def test_names_with_dots_namespaces_and_what_is_left_out(read) -> None:
    flat = {
        "FollowPath.plugin": PLUGIN,
        "FollowPath.vx_max": 0.9,
        "FollowPath.critics": ["CostCritic"],
    }
    tree = {"robot1": {"controller_server": {"ros__parameters": flat}}}
    found = read(tree)
    assert found.entries["robot"]["max_speed"] == 0.9
    # What a file leaves out has nav2's default, and a critic's default weight is the one here.
    assert found.entries["controller"]["horizon"] == 56
    assert found.entries["rates"]["control"] == 20.0
    assert found.entries["controller"]["obstacle_weight"] == 1.0
    assert found.left_out == ()


def test_one_of_several_controllers(read, fails, tmp_path, monkeypatch) -> None:
    tree = parameters()
    server = tree["controller_server"]["ros__parameters"]
    server["Precise"] = {**copy.deepcopy(FOLLOW), "vx_max": 0.2}
    assert read(tree, "exploration", "Precise").entries["robot"]["max_speed"] == 0.2
    monkeypatch.chdir(tmp_path)
    accepted = "accepted: one of FollowPath, Precise"
    assert f"controller is None; {accepted}" in fails("import-nav2", "nav2_params.yaml")
    line = fails("import-nav2", "nav2_params.yaml", "--controller", "Fast")
    assert f"controller is 'Fast'; {accepted}" in line


def test_the_command_writes_settings_that_are_read_again(
    tmp_path, monkeypatch, capsys, fails
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("nav2_params.yaml").write_text(yaml.safe_dump(parameters()))
    main(["import-nav2", "nav2_params.yaml", "-o", "settings.yaml"])
    told = capsys.readouterr().out.splitlines()
    expected = read_nav2(Path("nav2_params.yaml"))
    assert len(told) == 1 + len(expected.left_out)
    assert told[0] == "settings.yaml: settings for jaxplore run --settings"
    assert all(line.startswith("no counterpart: FollowPath.") for line in told[1:])
    text = Path("settings.yaml").read_text()
    assert yaml.safe_load(text) == expected.entries
    assert all(f"# {each.name}: {each.reason}" in text for each in expected.left_out)
    main(["import-nav2", "nav2_params.yaml"])
    assert capsys.readouterr().out == text
    line = fails("import-nav2", "nav2_params.yaml", "-o", "settings.yaml")
    assert "settings.yaml exists; accepted: another file, or --overwrite" in line
    main(["import-nav2", "nav2_params.yaml", "-o", "settings.yaml", "--overwrite"])


@pytest.mark.parametrize(
    ("follow", "message"),
    [
        ({"vx_max": "fast"}, "FollowPath.vx_max is 'fast'; accepted: a number"),
        ({"vx_max": -1.0}, "FollowPath.vx_max is -1; accepted: a number > 0"),
        ({"model_dt": True}, "FollowPath.model_dt is True; accepted: a number"),
        ({"ax_max": 10**400}, "FollowPath.ax_max is "),
        ({"time_steps": 2.5}, "FollowPath.time_steps is 2.5; accepted: a whole number >= 1"),
        (
            {"motion_model": "Hover"},
            "motion_model is 'Hover'; accepted: DiffDrive, Omni",
        ),
        (
            {"critics": "CostCritic"},
            "critics is 'CostCritic'; accepted: a list of names",
        ),
        ({"ax_max": 0.0}, "setting robot.max_acceleration is 0.0; accepted: "),
        ({"CostCritic": {"cost_weight": -1}}, "setting controller.obstacle_weight is -"),
        ({"plugin": None}, "has no controller; accepted: parameters of nav2"),
        ({".".join("a" * 30): 1}, "has too many dots; accepted: 20"),
    ],
    ids=str,
)
def test_a_wrong_value_is_one_line(follow, message, tmp_path, monkeypatch, fails) -> None:
    monkeypatch.chdir(tmp_path)
    Path("nav2_params.yaml").write_text(yaml.safe_dump(parameters(follow)))
    assert message in fails("import-nav2", "nav2_params.yaml", "-o", "settings.yaml")


@pytest.mark.parametrize(
    ("costmap", "message"),
    [
        ({"footprint": "[[0.3, 0.2"}, "local_costmap.footprint is '[[0.3, 0.2'; accepted: [[x, y]"),
        ({"footprint": "[" * 5000}, "local_costmap.footprint is "),
        ({"footprint": "[[1], [2]]"}, "local_costmap.footprint is [[1], [2]]; accepted: [x, y]"),
        ({"robot_radius": None}, "local_costmap.robot_radius is None; accepted: a number"),
    ],
    ids=str,
)
def test_a_wrong_robot_is_one_line(costmap, message, tmp_path, monkeypatch, fails) -> None:
    monkeypatch.chdir(tmp_path)
    Path("nav2_params.yaml").write_text(yaml.safe_dump(parameters(None, costmap)))
    assert message in fails("import-nav2", "nav2_params.yaml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds None; accepted: a YAML mapping of a nav2 parameter file"),
        ("a: [1", "is not a nav2 parameter file's YAML"),
        ("a: &b {c: 1}\nd: *b", "it uses YAML aliases"),
        ("a: " + "[" * 50 + "]" * 50, "it nests more than 20 deep"),
        ("a: !!python/object:os.system {}", "is not a nav2 parameter file's YAML"),
        ("a: 1 # " + "x" * 200_000, "is too large"),
    ],
    ids=lambda text: text[:20],
)
def test_a_wrong_file_is_one_line(text, message, tmp_path, monkeypatch, fails) -> None:
    monkeypatch.chdir(tmp_path)
    Path("nav2_params.yaml").write_text(text)
    assert message in fails("import-nav2", "nav2_params.yaml")
    assert "is not there" in fails("import-nav2", "missing.yaml")
