"""Settings from the parameter file of nav2's MPPI controller.

Numbers are taken over where they mean the same here. A weight of a cost keeps its ratio to nav2's
default, because the costs have other units. Whatever has no counterpart is named with the reason.
"""

import math
from pathlib import Path
from typing import Any, NamedTuple

from jaxplore._files import read_yaml
from jaxplore._text import printable_path, short_repr
from jaxplore.planning.presets.explorer import explorer
from jaxplore.planning.presets.path_following import avoidance_cost, mpcc
from jaxplore.ros import nav2_reasons as reasons
from jaxplore.ros.nav2_file import (
    PLUGIN,
    Outline,
    Tree,
    as_flat,
    as_nested,
    controllers,
    costmap,
    find,
    number,
    other_controllers,
    outline,
    smoother,
)
from jaxplore.settings.defaults import Owner, parameter_default
from jaxplore.settings.readers import find_readers, list_unread, remove
from jaxplore.settings.robot import RobotSettings
from jaxplore.tasks.exploration.settings import OFFICE, make_exploration_settings
from jaxplore.tasks.path.settings import PATH, TRACK, PathRobotSettings, make_path_settings

MODELS = {
    "DiffDrive": "differential_drive",
    "Omni": "omnidirectional",
    "Ackermann": "ackermann",
}
"""Models of robots by the motion models of nav2."""
CAR = "AckermannConstraints"
"""Parameters of a car where the motion model is no instance with its own."""
NAV2 = {
    "time_steps": 56,
    "model_dt": 0.05,
    "batch_size": 1000,
    "temperature": 0.3,
    "vx_std": 0.2,
    "vy_std": 0.2,
    "wz_std": 0.4,
    "vx_max": 0.5,
    "vx_min": -0.35,
    "vy_max": 0.5,
    "wz_max": 1.9,
    "ax_max": 3.0,
    "ax_min": -3.0,
    "az_max": 3.5,
    f"{CAR}.min_turning_r": 0.2,
}
"""Defaults of nav2, which hold for what a file leaves out."""
MOST_STEERING = 1.5
"""Greatest steering angle of a car that turns on a tiny circle [rad]."""
FREQUENCY = 20.0
"""Default of nav2's `controller_frequency` [Hz]."""


class _Weight(NamedTuple):
    """Weight of a critic: its parameter, nav2's default, and the setting with its owner."""

    parameter: str
    default: float
    setting: str
    owner: Owner
    name: str


_WEIGHTS = {
    "exploration": {
        "CostCritic": _Weight(
            "cost_weight", 3.81, "controller.obstacle_weight", explorer, "obstacle_weight"
        ),
        "ObstaclesCritic": _Weight(
            "repulsion_weight", 1.5, "controller.obstacle_weight", explorer, "obstacle_weight"
        ),
        "PathFollowCritic": _Weight(
            "cost_weight", 5.0, "controller.guidance_weight", explorer, "guidance_weight"
        ),
    },
    "path": {
        "CostCritic": _Weight("cost_weight", 3.81, "obstacles.weight", avoidance_cost, "weight"),
        "ObstaclesCritic": _Weight(
            "repulsion_weight", 1.5, "obstacles.weight", avoidance_cost, "weight"
        ),
        "PathAlignCritic": _Weight(
            "cost_weight", 10.0, "controller.contouring_weight", mpcc, "contouring_weight"
        ),
        "PathAlignLegacyCritic": _Weight(
            "cost_weight", 10.0, "controller.contouring_weight", mpcc, "contouring_weight"
        ),
        "PathFollowCritic": _Weight(
            "cost_weight", 5.0, "controller.progress_weight", mpcc, "progress_weight"
        ),
    },
}
"""Critics with a counterpart, by the kind of task."""


class LeftOut(NamedTuple):
    """A parameter of nav2 without a counterpart, and the reason."""

    name: str
    reason: str


class Nav2Settings(NamedTuple):
    """What became of a parameter file of nav2.

    Args:
        entries: settings entries, which the settings of the task accept.
        left_out: parameters of the controller without a counterpart.
    """

    entries: dict[str, Any]
    left_out: tuple[LeftOut, ...]


def read_nav2(path: Path, task: str = "exploration", controller: str | None = None) -> Nav2Settings:
    """Read the MPPI controller of a parameter file of nav2, or the robot of another one.

    Of other controllers (DWB, regulated pure pursuit and those with the same names) the limits of
    the robot, its shape and the rate are taken, from the velocity smoother where they have none.

    Args:
        path: YAML file with the parameters of `controller_server` and of the costmaps.
        task: kind of run that the settings are for, `exploration` or `path`.
        controller: name of the controller, such as `FollowPath`; needed if the file has several.

    Raises:
        ValueError: a file that is missing, too large or no YAML mapping; a file without an MPPI
            controller, or with several and no name; a value that is not accepted.
    """
    if task not in _WEIGHTS:
        raise ValueError(f"task is {task!r}; accepted: {', '.join(_WEIGHTS)}")
    where = printable_path(path)
    tree = as_nested(read_yaml(path, "nav2 parameter file"))
    mppi = controllers(tree)
    found = {**other_controllers(tree), **mppi}
    # Without a name one of MPPI is taken before others of the same file.
    asked = mppi or found
    named = asked if controller is None else {k: v for k, v in found.items() if k == controller}
    if not found:
        raise ValueError(
            f"{where} has no controller; accepted: parameters of nav2's controller_server with "
            f"one, of {PLUGIN} or another"
        )
    if len(named) != 1:
        names = ", ".join(found)
        raise ValueError(f"controller is {controller!r}; accepted: one of {names}, as in {where}")
    ((name, (server, section)),) = named.items()
    given = _Given(name, as_flat(section))
    entries: dict[str, Any] = {"map": OFFICE} if task == "exploration" else {PATH: TRACK}
    writer = _Writer(entries, task)
    if name in mppi:
        _robot(given, writer, tree)
        _sampling(given, writer)
        _critics(given, writer)
    else:
        _other_robot(given, writer, tree)
    _rates(writer, server)
    _clearance(writer, tree)
    for rest in given.list_unread() if name in mppi else ():
        given.leave(rest, reasons.of_parameter(rest))
    check = make_exploration_settings if task == "exploration" else make_path_settings
    settings = check(entries)
    for setting, value in list_unread(settings, entries).items():
        readers = find_readers(type(settings), setting).text
        given.left_out.append(LeftOut(setting, f"{value:g} by nav2, for {readers}"))
        remove(entries, setting)
    return Nav2Settings(entries, tuple(given.left_out))


class _Given:
    """Parameters of a controller by their dotted names; it notes which were read."""

    def __init__(self, name: str, values: dict[str, Any]) -> None:
        self.name, self.values = name, values
        self.left_out: list[LeftOut] = []
        self._read = {"plugin", "critics"}
        listed = values.get("critics", [])
        if not isinstance(listed, list) or not all(isinstance(each, str) for each in listed):
            given = short_repr(listed)
            raise ValueError(f"{name}.critics is {given}; accepted: a list of names")
        self.critics: list[str] = listed

    def number(self, name: str, default: float | None = None) -> float:
        """Return a finite number; a default, or nav2's, if the file leaves it out."""
        self._read.add(name)
        fallback = NAV2.get(name) if default is None else default
        return number(f"{self.name}.{name}", self.values.get(name, fallback))

    def positive(self, name: str) -> float:
        """Return a number above zero."""
        value = self.number(name)
        if value <= 0.0:
            raise ValueError(f"{self.name}.{name} is {value:g}; accepted: a number > 0")
        return value

    def count(self, name: str) -> int:
        """Return a whole number of at least one."""
        value = self.number(name)
        if value < 1 or value != int(value):
            raise ValueError(f"{self.name}.{name} is {value:g}; accepted: a whole number >= 1")
        return int(value)

    def read(self, name: str) -> Any:
        """Return any value; None if the file leaves it out."""
        self._read.add(name)
        return self.values.get(name)

    def leave(self, name: str, reason: str) -> None:
        """Note that a parameter, or a critic with all of its own, has no counterpart.

        What the file does not have is not noted.
        """
        of_it = {key for key in self.values if key == name or key.startswith(f"{name}.")}
        self._read |= of_it
        if of_it or name in self.critics:
            self.left_out.append(LeftOut(f"{self.name}.{name}", reason))

    def list_unread(self) -> list[str]:
        """Return the names that nothing has read."""
        return [name for name in self.values if name not in self._read]


class _Writer:
    """Settings entries that are being made."""

    def __init__(self, entries: dict[str, Any], task: str) -> None:
        self.entries, self.task = entries, task

    def set(self, name: str, value: Any) -> None:
        """Set one setting by its dotted name."""
        section, _, last = name.rpartition(".")
        place = self.entries.setdefault(section, {}) if section else self.entries
        place[last] = round(value, 6) if isinstance(value, float) else value

    def has(self, name: str) -> bool:
        """Return whether a setting was set."""
        section, _, last = name.rpartition(".")
        return last in self.entries.get(section, {})


def _robot(given: _Given, to: _Writer, tree: Tree) -> None:
    """Translate the motion model, the limits, and the footprint of the costmaps."""
    motion = given.read("motion_model") or "DiffDrive"
    # In newer versions the name is that of a class, such as `mppi::DiffDriveMotionModel`, or of an
    # instance, whose class is its `plugin`.
    kind = given.read(f"{motion}.plugin") or motion
    word = str(kind).rpartition("::")[2].removesuffix("MotionModel")
    if word not in MODELS:
        raise ValueError(
            f"{given.name}.motion_model is {short_repr(kind)}; accepted: {', '.join(MODELS)}, or "
            "the name of an instance whose plugin is one of them"
        )
    model = MODELS[word]
    to.set("robot.model", model)
    to.set("robot.max_speed", given.positive("vx_max"))
    to.set("robot.max_acceleration", abs(given.number("ax_max")))
    to.set("robot.max_deceleration", abs(given.number("ax_min")))
    # nav2 has no drag.
    to.set("robot.drag", 0.0)
    if model == "differential_drive":
        given.leave("vx_min", reasons.FORWARDS)
    else:
        to.set("robot.min_speed", given.number("vx_min"))
    if model == "omnidirectional":
        to.set("robot.max_lateral_speed", given.positive("vy_max"))
        for name in ("ay_max", "ay_min"):
            given.leave(name, reasons.LATERAL)
    else:
        for name in ("vy_max", "vy_std", "ay_max", "ay_min"):
            given.leave(name, reasons.NOT_LATERAL)
    shape = outline(tree)
    if model == "ackermann":
        _car(given, to, shape, str(motion))
        return
    to.set("robot.max_turn_rate", given.positive("wz_max"))
    to.set("robot.max_angular_acceleration", given.positive("az_max"))
    for section in (CAR, motion):
        given.leave(f"{section}.min_turning_r", reasons.NOT_A_CAR)
    _shape(to, shape)


LIMITS = {
    "max_speed": ("max_vel_x", "desired_linear_vel", "v_linear_max"),
    "max_turn_rate": ("max_vel_theta", "rotate_to_heading_angular_vel", "v_angular_max"),
    "max_acceleration": ("acc_lim_x", "max_linear_accel"),
    "max_deceleration": ("decel_lim_x", "max_linear_decel"),
    "max_angular_acceleration": ("acc_lim_theta", "max_angular_accel"),
}
"""Limits of a robot by the names that controllers other than MPPI have for them."""
_SMOOTHED = {
    "max_speed": ("max_velocity", 0),
    "max_turn_rate": ("max_velocity", 1),
    "max_acceleration": ("max_accel", 0),
    "max_deceleration": ("max_decel", 0),
    "max_angular_acceleration": ("max_accel", 1),
}


def _other_robot(given: _Given, to: _Writer, tree: Tree) -> None:
    """Take the robot of another controller than MPPI."""
    given.left_out.append(LeftOut(given.name, reasons.OTHER))
    to.set("robot.model", "differential_drive")
    smoothed = smoother(tree)
    for limit, names in LIMITS.items():
        known = [name for name in names if name in given.values]
        listed, axis = _SMOOTHED[limit]
        if known:
            name, value = f"{given.name}.{known[0]}", given.values[known[0]]
        elif listed in smoothed:
            name, value = f"velocity_smoother.{listed}", smoothed[listed][axis]
        else:
            continue
        bound = abs(number(name, value)) if limit == "max_deceleration" else number(name, value)
        if bound <= 0.0:
            raise ValueError(f"{name} is {bound:g}; accepted: a number > 0")
        to.set(f"robot.{limit}", bound)
    _shape(to, outline(tree))


def _shape(to: _Writer, shape: Outline) -> None:
    """Set the radius of the disc around a robot."""
    if isinstance(shape, float):
        to.set("robot.radius", shape)
    elif shape:
        to.set("robot.radius", max(math.hypot(*corner) for corner in shape))


def _car(given: _Given, to: _Writer, shape: Outline, motion: str) -> None:
    """Translate the turning circle and the shape of a car, of an instance of a motion model."""
    kind = RobotSettings if to.task == "exploration" else PathRobotSettings
    wheelbase = float(kind.model_fields["wheelbase"].default)
    if shape is not None:
        corners = [(-shape, -shape), (shape, shape)] if isinstance(shape, float) else shape
        xs, ys = zip(*corners, strict=True)
        # nav2 has no wheelbase: it keeps its share of the length.
        wheelbase *= (max(xs) - min(xs)) / float(kind.model_fields["length"].default)
        to.set("robot.length", max(xs) - min(xs))
        to.set("robot.width", max(ys) - min(ys))
        to.set("robot.wheelbase", wheelbase)
    section = motion if f"{motion}.min_turning_r" in given.values else CAR
    radius = given.positive(f"{section}.min_turning_r")
    to.set("robot.max_steering", min(math.atan(wheelbase / radius), MOST_STEERING))
    for each in ("wz_max", "az_max"):
        given.leave(each, reasons.STEERED)


def _sampling(given: _Given, to: _Writer) -> None:
    """Translate the horizon, the samples and their noise."""
    steps, dt = given.count("time_steps"), given.positive("model_dt")
    to.set("controller.horizon", steps)
    to.set("controller.dt", dt)
    to.set("controller.num_samples", given.count("batch_size"))
    model = to.entries["robot"]["model"]
    is_lateral = model == "omnidirectional"
    names = ["vx_std", "vy_std", "wz_std"] if is_lateral else ["vx_std", "wz_std"]
    if to.task == "path":
        given.leave("temperature", reasons.TEMPERATURE)
    else:
        to.set("controller.temperature", given.positive("temperature"))
    if to.task == "path" or model == "ackermann":
        for name in names:
            given.leave(name, reasons.PATH_NOISE if to.task == "path" else reasons.CAR_NOISE)
        return
    # White noise of an acceleration is a random walk of the speed, whose mean square over the
    # horizon is that of nav2's noise.
    walk = dt * math.sqrt(0.5 * (steps + 1.0))
    to.set("controller.noise_std", [round(given.positive(name) / walk, 6) for name in names])


def _critics(given: _Given, to: _Writer) -> None:
    """Translate the weights of critics that have a counterpart, and name the others."""
    sections = {key.partition(".")[0] for key in given.values if "Critic." in key}
    for critic in sorted(sections - set(given.critics)):
        given.leave(critic, reasons.NOT_LISTED)
    for critic in given.critics:
        if given.read(f"{critic}.enabled") is False:
            given.leave(critic, reasons.DISABLED)
        elif critic in _WEIGHTS[to.task]:
            _weight(given, to, critic)
        else:
            given.leave(critic, reasons.of_critic(critic, to.task))


def _weight(given: _Given, to: _Writer, critic: str) -> None:
    weight = _WEIGHTS[to.task][critic]
    name = f"{critic}.{weight.parameter}"
    if to.has(weight.setting):
        given.leave(name, f"{weight.setting} is that of another critic")
    else:
        ratio = given.number(name, weight.default) / weight.default
        to.set(weight.setting, ratio * float(parameter_default(weight.owner, weight.name)))
    power = f"{critic}.cost_power"
    if given.number(power, 1.0) != 1.0:
        given.leave(power, reasons.POWER)
    if critic == "ObstaclesCritic" and f"{critic}.inflation_radius" in given.values:
        _set_clearance(to, given.number(f"{critic}.inflation_radius"))


def _rates(to: _Writer, server: Tree) -> None:
    """Translate the rate of control; scans and fields get whole fractions of it."""
    rate = number("controller_frequency", server.get("controller_frequency", FREQUENCY))
    if rate <= 0.0:
        raise ValueError(f"controller_frequency is {rate:g}; accepted: a number > 0")
    if to.task == "path":
        to.set("control_rate", rate)
        return
    to.set("rates.control", rate)
    for name, most in (("rates.sensing", 10.0), ("rates.fields", 5.0)):
        to.set(name, rate / math.ceil(rate / most))


def _clearance(to: _Writer, tree: Tree) -> None:
    """Translate the radius of the local costmap's inflation."""
    layer = find(costmap(tree, "local_costmap"), lambda _, each: "inflation_radius" in each)
    section = "controller" if to.task == "exploration" else "obstacles"
    if layer is not None and not to.has(f"{section}.clearance"):
        _set_clearance(to, number("inflation_radius", layer["inflation_radius"]))


def _set_clearance(to: _Writer, radius: float) -> None:
    to.set("controller.clearance" if to.task == "exploration" else "obstacles.clearance", radius)
