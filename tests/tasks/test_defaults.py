"""The command line and Python build equal controllers: a default stands in one place."""

import inspect
import math
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.planning.presets.quadrotor import zone_choice
from jaxplore.planning.presets.target_explorer import target_explorer
from jaxplore.settings.architectures import BASELINES
from jaxplore.settings.defaults import (
    DIFFERENCES,
    arguments,
    descriptions,
    parameter_default,
    setting,
    unit,
)
from jaxplore.settings.node import DriveSettings
from jaxplore.settings.sections import Section, read_settings, section_class
from jaxplore.simulation.exploration import scenario as scenario_module
from jaxplore.simulation.exploration.reachability import drivable_cells
from jaxplore.tasks.exploration.settings import SCENARIOS, ExplorationSettings, scenario_path
from jaxplore.tasks.path.settings import PathFollowingSettings
from jaxplore.tasks.reference import own_descriptions
from jaxplore.tasks.registry import build, make_settings
from jaxplore.tasks.volume.settings import VolumeExplorationSettings

pytestmark = pytest.mark.long


def assert_equal(found: Any, expected: Any) -> None:
    """Compare all leaves and the structure, static fields included."""
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    paths, expected_leaves = jax.tree_util.tree_leaves_with_path(found), jax.tree.leaves(expected)
    for (path, leaf), other in zip(paths, expected_leaves, strict=True):
        name = jax.tree_util.keystr(path)
        assert jax.typeof(leaf) == jax.typeof(other), name
        np.testing.assert_array_equal(leaf, other, err_msg=name)


# What is a scenario's own: its robot, the integrator of its plans, its mission and its sensor.


def office_robot(integrator: jx.Integrator | None = None) -> jx.Dynamics:
    return jx.DifferentialDrive(max_speed=1.0, integrator=integrator)


def warehouse_robot(integrator: jx.Integrator | None = None) -> jx.Dynamics:
    return jx.DifferentialDrive(max_speed=1.0, radius=0.3, integrator=integrator)


def perimeter_robot(integrator: jx.Integrator | None = None) -> jx.Dynamics:
    return jx.DifferentialDrive(max_speed=1.5, radius=0.3, integrator=integrator)


def rescue_robot(integrator: jx.Integrator | None = None) -> jx.Dynamics:
    return jx.Ackermann(
        wheelbase=0.5,
        max_speed=2.0,
        max_steering=0.6,
        max_acceleration=2.0,
        max_steering_rate=1.0,
        min_speed=-1.0,
        drag=0.1,
        footprint=jx.Rectangle(0.625, 0.125, 0.4),
        integrator=integrator,
    )


ROBOTS: dict[str, Callable[..., jx.Dynamics]] = {
    "office": office_robot,
    "zones": office_robot,
    "warehouse": warehouse_robot,
    "search-rescue": rescue_robot,
    "perimeter": perimeter_robot,
}
GOALS = {"zones": jx.three_zones().goal}
MISSIONS = {
    "zones": jx.Mission(GOALS["zones"][:2]),
    "search-rescue": jx.Mission(
        has_terrain=True, chassis=jx.geometry.Chassis(0.5, 0.4, 0.4, offset=0.25)
    ),
    "perimeter": jx.Mission(has_moving_obstacles=True, occlusion_cost=jx.costs.OcclusionCost(1.6)),
}
VIEWS = {"warehouse": 1.5 * math.pi}
"""Of the lidars, where a scenario says so."""


def by_hand(place: str, architecture: str, scenario: jx.ExplorationScenario) -> Any:
    """Return the controller as Python makes it, with what is the scenario's own."""
    robot, goal = ROBOTS[place](), GOALS.get(place)
    own = read_settings(scenario_path(place)) if place in SCENARIOS else {}
    mission = MISSIONS.get(place, jx.Mission())
    has_moving, chassis = mission.has_moving_obstacles, mission.chassis
    if architecture == "explorer":
        return jx.explorer(
            robot,
            has_moving_obstacles=has_moving,
            occlusion_cost=mission.occlusion_cost,
            chassis=chassis,
        )
    if architecture == "portfolio":
        numbers = own.get("portfolio", {})
        return jx.ground_portfolio(ROBOTS[place](jx.Euler()), MISSIONS.get(place), **numbers)
    if architecture in BASELINES:
        return target_explorer(
            robot,
            architecture,
            scenario.perception,
            scenario.world,
            has_moving_obstacles=has_moving,
            occlusion_cost=mission.occlusion_cost,
            chassis=chassis,
        )
    flight, fields = jx.Flight(), jx.FieldNumbers()
    if place in SCENARIOS:
        flight = jx.Flight(max_speed=robot.max_speed)
        fields = jx.FieldNumbers(field_of_view=VIEWS.get(place, math.tau))
    else:
        robot = jx.Quadrotor()
    if architecture == "random-walk":
        return jx.planning.random_walk(robot, flight)
    if architecture == "goal":
        return jx.planning.goal_mppi(robot, goal, flight)
    choice = None
    if architecture == "sequential":
        zones = jx.belief.Zones.from_rectangles(jx.three_zones().zones, scenario.world)
        lidar = jx.Lidar(24, 4.0, math.pi / 2.0)
        choice = zone_choice(zones, goal[:2], scenario.perception, lidar)
    return jx.informative_mppi(
        robot,
        "parallel" if architecture == "parallel" else "two-layer",
        resolution=scenario.world.resolution,
        sensor_model=scenario.perception.sensor_model,
        goal=goal,
        flight=flight,
        fields=fields,
        target_choice=choice,
    )


EVERYWHERE = ("explorer", "portfolio", BASELINES[0], "parallel", "random-walk")
CASES = [
    *((place, architecture) for place in ROBOTS for architecture in EVERYWHERE),
    # They differ in their rule, wherever they are.
    *(("office", rule) for rule in BASELINES[1:]),
    *((place, "two-layer") for place in ROBOTS),
    ("zones", "sequential"),
    ("zones", "goal"),
]


@pytest.fixture(scope="module", autouse=True)
def _reachable_cells_of_a_place_are_computed_once():
    """Where a car gets to takes seconds, and is the same whichever architecture asks."""
    found: dict[Any, np.ndarray] = {}

    def once(
        world: Any, start: np.ndarray, robot: jx.Dynamics, perception: Any, datum: Any
    ) -> np.ndarray:
        turns = type(perception.locomotion)
        key = world.shape, tuple(start.tolist()), float(robot.radius), turns
        if key not in found:
            found[key] = drivable_cells(world, start, robot, perception, datum)
        return found[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scenario_module, "drivable_cells", once)
        yield


# People walk in the perimeter, and a quadrotor says that it knows nothing of them.
@pytest.mark.filterwarnings("ignore:architecture .* knows nothing of people:UserWarning")
@pytest.mark.parametrize(("place", "architecture"), CASES)
def test_settings_and_python_build_equal_controllers(place: str, architecture: str) -> None:
    found = build(make_settings({"map": place, "architecture": architecture}))
    assert_equal(found.controller, by_hand(place, architecture, found.scenario))


RACE_CAR = jx.Ackermann(
    wheelbase=0.33,
    max_speed=5.0,
    max_steering=0.42,
    max_acceleration=6.0,
    max_steering_rate=3.2,
    footprint=jx.Rectangle(0.455, 0.125, 0.31),
)


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        ({}, {}),
        ({"obstacles": {"number": 5}}, {"other": jx.planning.avoidance_cost()}),
        (
            {"obstacles": {"discs": [[0.0, 0.0, 0.1]]}, "controller": {"risk_level": 0.9}},
            {
                "other": jx.planning.avoidance_cost(caution=0.0),
                "disturbance": jx.control.UncertainObstacles(),
                "risk": jx.ConditionalValueAtRisk(0.9),
            },
        ),
    ],
    ids=["alone", "traffic", "risk"],
)
def test_settings_and_python_build_equal_controllers_along_a_path(
    entries: dict[str, Any], expected: dict[str, Any]
) -> None:
    track = jx.race_track()
    found, made = (
        build(make_settings({"map": "path", **entries})),
        jx.mpcc(RACE_CAR, track, **expected),
    )
    assert_equal(found.controller, made.controller)
    assert_equal(found.scenario.robot, made.model)
    assert_equal(found.scenario.path, track)


def test_a_default_that_drifts_is_found() -> None:
    made = jx.mpcc(RACE_CAR, jx.race_track())
    for changes in ({"temperature": 31.0}, {"horizon": 31}, {"comfort_weight": None}):
        other = jx.mpcc(RACE_CAR, jx.race_track(), **changes)
        with pytest.raises(AssertionError):
            assert_equal(other.controller, made.controller)


# Every setting has an owner, or a description of its own


def sections(kind: type[Section]) -> list[type[Section]]:
    """Return a class of settings and those of its sections."""
    found = [kind]
    for field in kind.model_fields.values():
        inner = section_class(field.annotation)
        if inner is not None:
            found += sections(inner)
    return found


SECTIONS = [
    *sections(ExplorationSettings),
    *sections(PathFollowingSettings),
    *sections(VolumeExplorationSettings),
]


def owners(kind: type[Section]) -> dict[str, tuple[str, str]]:
    """Return owner and parameter of those settings of a section that have one."""
    return {
        name: (field.json_schema_extra["owner"], field.json_schema_extra["parameter"])
        for name, field in kind.model_fields.items()
        if field.json_schema_extra is not None
    }


@pytest.mark.parametrize("kind", SECTIONS)
def test_every_setting_is_described_once(kind: type[Section]) -> None:
    own = own_descriptions(kind)
    for name, field in kind.model_fields.items():
        assert bool(field.description) != (name in own), name


NOT_SETTINGS: dict[Callable[..., Any], set[str]] = {
    # Of the robot and the world.
    jx.explorer: {
        *("robot", "has_moving_obstacles", "moving_obstacle_cost", "occlusion_cost", "chassis"),
        "uncertain",
    },
    jx.ground_portfolio: {"robot", "mission", "members", "fusion"},
    # Of the robot, the rates and the run.
    jx.Flight: {"control_period", "max_speed"},
    jx.FieldNumbers: {"field_of_view", "field_period"},
    jx.informative_mppi: {
        *("robot", "architecture", "resolution", "sensor_model", "goal", "flight", "fields"),
        *("reference", "target_choice"),
    },
    zone_choice: {"zones", "goal", "perception", "lidar"},
    jx.planning.volume_informative_mppi: {
        *("robot", "architecture", "perception", "grid", "strategy_period", "flying"),
    },
    jx.mpcc: {
        *("robot", "path", "noise_std", "max_speed", "other", "corridor"),
        *("end_heading", "disturbance", "risk"),
    },
    jx.planning.avoidance_cost: set(),
    jx.race_track: set(),
    jx.office: set(),
    jx.Lidar: {"errors", "mount"},
    jx.Camera: set(),
    jx.parts.IdlenessMap: set(),
    jx.parts.Recognition: {"detector"},
    jx.InverseSensorModel: {"is_decisive"},
    jx.geometry.Chassis: {"wheelbase", "track", "offset"},
    jx.maps.Ground: {"elevation", "resolution", "origin", "traversability"},
    jx.Perception: {
        *("sensors", "resolution", "robot_radius", "sensor_model", "goal", "max_unknown"),
        *("ground", "parts", "is_goal_apart", "unknown_factor", "car"),
        *("is_localising", "goal_heading", "tracker"),
    },
    jx.planning.Contextual: {"names", "goal", "rules"},
    jx.planning.WeightedVote: set(),
}
"""Parameters that are no settings: parts, or what follows from other settings."""


@pytest.mark.parametrize("owner", NOT_SETTINGS, ids=lambda owner: owner.__qualname__)
def test_every_number_of_a_preset_is_a_setting(owner: Callable[..., Any]) -> None:
    declared = [each for kind in SECTIONS for each in owners(kind).values()]
    settings = {parameter for name, parameter in declared if name == owner.__qualname__}
    assert settings | NOT_SETTINGS[owner] == set(inspect.signature(owner).parameters)
    assert not settings & NOT_SETTINGS[owner]


def test_differences_are_differences_and_have_a_reason() -> None:
    owned = {
        "exploration": ExplorationSettings,
        "path": PathFollowingSettings,
        "drive": DriveSettings,
    }
    owners = {
        "exploration.robot": jx.DifferentialDrive,
        "path.robot": jx.Ackermann,
        "exploration.lidar": jx.Lidar,
        "drive.node.contouring": jx.mpcc,
    }
    ground = make_settings({"map": "office"})
    for name, difference in DIFFERENCES.items():
        kind, *sections, last = name.split(".")
        assert difference.reason
        if kind in ("quadrotor", "car", "bicycle"):
            (section,) = sections
            assert getattr(getattr(ground, section), last) != difference.value
            continue
        settings = owned[kind]
        for section in sections:
            settings = section_class(settings.model_fields[section].annotation)
        assert settings.model_fields[last].default == difference.value
        owner = owners[".".join([kind, *sections])]
        assert parameter_default(owner, last) != difference.value


def test_a_car_that_explores_can_reverse_unless_it_is_told_otherwise() -> None:
    given = {"map": "office", "robot": {"model": "ackermann"}}
    assert make_settings(given).robot.min_speed == -0.5
    forwards = make_settings({**given, "robot": {"model": "ackermann", "min_speed": 0.0}})
    assert forwards.robot.min_speed == 0.0


def test_the_owner_s_signature_is_the_default() -> None:
    def preset(robot: object, *, weight: float = 2.5, reach: float = 1.0) -> None:
        """Do something.

        Args:
            robot: its model.
            weight: of the cost,
                which is high [1/m].
            reach: of the lidar [m].

        Raises:
            ValueError: never.
        """

    class Own(Section):
        heavy: float = setting(preset, "weight")
        reach: float = setting(preset, "reach", lambda metres: 100.0 * metres)

    assert Own().model_dump() == {"heavy": 2.5, "reach": 100.0}
    assert arguments(Own(heavy=3.0), preset) == {"weight": 3.0, "reach": 100.0}
    described = Own.model_fields["heavy"].description
    assert described == "of the cost, which is high [1/m]."
    assert unit(described) == "1/m"
    assert unit("of the cost.") is None
    assert set(descriptions(preset)) == {"robot", "weight", "reach"}
    for name in ("robot", "speed"):
        with pytest.raises(
            ValueError, match=f"parameter is '{name}' of .*preset; accepted: weight"
        ):
            parameter_default(preset, name)


# Which kind of run


@pytest.mark.parametrize(
    ("entries", "kind"),
    [
        ({"map": "office"}, ExplorationSettings),
        ({"map": "path", "world": {"size": [1.0, 1.0]}}, ExplorationSettings),
        ({"map": "path"}, PathFollowingSettings),
        ({"map": "path", "path": "a.csv"}, PathFollowingSettings),
        ({"path": "track"}, PathFollowingSettings),
    ],
)
def test_entries_say_which_kind_of_run_they_are(entries: dict[str, Any], kind: type) -> None:
    found = make_settings(entries)
    assert type(found) is kind
    if kind is PathFollowingSettings:
        assert found.path == entries.get("path", "track")


DETECTOR = {"classes": ["door", "shelf"], "confusion": [[0.9, 0.1], [0.1, 0.9]]}


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({}, "setting map is missing; accepted: the YAML file of a ROS map, or office"),
        ({"coverage": 0.9}, "unknown setting coverage; accepted here"),
        (
            {"map": "office", "parameters": {"cost.x": "a"}},
            "setting parameters.cost.x is 'a'; accepted: number or list of number$",
        ),
        (
            {"map": "office", "goal": [1]},
            r"setting goal is \[1\]; accepted: \[number, number\] or \[number, number, number\] or",
        ),
        (
            {"map": "office", "detector": DETECTOR | {"recall": [0.5, 2]}},
            r"setting detector.recall is \[0.5, 2\]; accepted: number in \(0, 1\] or list of",
        ),
        (
            {"map": "office", "detector": {"classes": ["door"]}},
            "setting detector.confusion is missing; accepted: list of list of number",
        ),
        (
            {"map": "office", "portfolio": {"weights": {"near": 3}}},
            "setting portfolio.weights.near is 3; accepted: mapping of names to number >= 0",
        ),
        (
            {"map": "office", "variation": {"parameters": {"drag": 1}}},
            r"setting variation.parameters.drag is 1; accepted: \[number, number\]$",
        ),
        (
            {"map": "office", "start": ["x", 1, 2]},
            "setting start.0 is 'x'; accepted: a valid number$",
        ),
        (
            {"map": "office", "fields": {"min_information": "x"}},
            "setting fields.min_information is 'x'; accepted: number > 0 or null$",
        ),
        (
            {"map": "office", "controller": {"num_samples": "x"}},
            r"setting controller.num_samples is 'x'; accepted: whole number in \[1, 1000000\]$",
        ),
        ({"map": "office", "guard": "x"}, "setting guard is 'x'; accepted: true or false"),
        ({"map": "office", "faults": 3}, "setting faults is 3; accepted: a mapping of settings$"),
        ({"map": "office", 3: 4}, "a setting is named 3; accepted: text in UTF-8"),
        ({"map": ["path"]}, "setting map is .'path'."),
        ({"map": "office", "path": "a.csv"}, "the map 'office' beside the path 'a.csv'; accepted"),
        (
            {"path": "track", "goal": [1, 2]},
            r"goal is \[1, 2\], which runs of path do not read; accepted: in runs of expl",
        ),
        ({"map": "office", "laps": 2}, "laps is 2, which runs of exploration do not read; acc"),
        (
            {"volume": "forest", "map_file": {"rules": "ros"}},
            "setting map_file is .*, which runs of volume do not read; accepted: in runs of expl",
        ),
    ],
)
def test_bad_entries_are_one_line(entries: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_settings(entries)
