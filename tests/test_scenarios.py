"""The scenarios of ground vehicles: their settings, and the command line that runs them."""

import itertools
import json
import math
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml
from PIL import Image

import jaxplore as jx
from jaxplore.cli import main
from jaxplore.parts import AnomalyTest, IdlenessMap
from jaxplore.simulation.loop import initial_loop_state, moment_at
from jaxplore.simulation.state import LoopState
from jaxplore.tasks.exploration.settings import SCENARIOS, is_scenario_file, read_settings
from jaxplore.tasks.exploration.settings import scenario_path as path_of
from jaxplore.tasks.registry import build, make_settings, without_unread

pytestmark = pytest.mark.long


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


# Those that come with the package


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    def one(name: str) -> Any:
        entries = read_settings(path_of(name))
        portfolio = {**entries.get("portfolio", {}), "num_samples": 128}
        return build(make_settings({**entries, "portfolio": portfolio}))

    return {name: one(name) for name in SCENARIOS}


@pytest.mark.parametrize("name", SCENARIOS)
def test_each_builds_with_a_portfolio_and_what_it_says(made, name: str) -> None:
    experiment, entries = made[name], read_settings(path_of(name))
    assert isinstance(experiment.controller, jx.Portfolio)
    assert experiment.controller.member_names == ("explorer", "balanced", "exploiter", "cautious")
    scenario, world = experiment.scenario, entries["world"]
    size = np.array(scenario.world.shape[::-1]) * scenario.world.resolution
    np.testing.assert_allclose(size, world["size"], atol=1e-6)
    np.testing.assert_allclose(scenario.start[:3], world["start"], atol=1e-6)
    assert scenario.num_targets == len(world.get("targets", ()))
    assert (scenario.ground is None) == ("hills" not in world)
    movers = [each for each in scenario.truths if isinstance(each, jx.MovingObstacles)]
    assert sum(len(each.radius) for each in movers) == len(world.get("movers", ()))
    assert experiment.num_steps == round(entries["time_limit"] * 50)
    # All of what is to be explored can be got to, or nearly.
    free = np.asarray(scenario.world.is_free)
    assert np.asarray(scenario.reachable).sum() > 0.4 * free.sum()


def test_the_warehouse_is_unknown_and_the_plan_of_the_perimeter_known(made) -> None:
    warehouse, perimeter = (made[name].scenario for name in ("warehouse", "perimeter"))
    np.testing.assert_array_equal(warehouse.prior.probability, 0.5)
    prior, truth = (np.asarray(grid.probability) for grid in (perimeter.prior, perimeter.world))
    planted = {each.name: each for each in perimeter.truths}["anomalies"]
    # Known but for what is planted: a box is new, a container is gone, and somebody is about.
    boxes = np.round(10.0 * np.asarray(planted.boxes)).astype(int)
    is_known = np.ones(truth.shape, bool)
    for left, low, right, high in boxes:
        is_known[low:high, left:right] = False
    np.testing.assert_array_equal(prior[is_known], truth[is_known])
    assert planted.kinds.tolist() == [1, 2, 3]
    assert perimeter.perception.part(AnomalyTest) is not None
    assert warehouse.truths == ()
    assert warehouse.perception.part(AnomalyTest) is None
    assert float(warehouse.target_coverage) == pytest.approx(0.95)
    (lidar,) = warehouse.sensors
    assert lidar.field_of_view == pytest.approx(1.5 * math.pi)
    assert warehouse.perception.part(IdlenessMap) is None
    assert float(perimeter.perception.part(IdlenessMap).memory) == 60.0
    assert float(perimeter.target_coverage) > 1.0


def test_a_camera_leads_in_the_search(made) -> None:
    search = made["search-rescue"].scenario
    assert [type(sensor) for sensor in search.sensors] == [jx.Camera, jx.Lidar]
    assert isinstance(search.robot, jx.Ackermann)
    assert isinstance(search.robot.footprint, jx.Rectangle)
    assert search.perception.part(IdlenessMap).memory is None
    # Its ground is known, and some of it closed; all targets are on ground that can be driven on.
    closed = ~np.asarray(search.ground.is_traversable)
    assert 0.01 < closed.mean() < 0.5
    rows, columns = np.asarray(search.world.frame.to_cell(search.targets)).T
    assert not closed[rows, columns].any()


@eqx.filter_jit
def plans(
    controller: jx.Portfolio, scenario: Any, state: LoopState, belief: Any, key: jax.Array
) -> jax.Array:
    """Return the plans of all members in the first two seconds, without another look."""

    def step(carry: Any, number: jax.Array) -> Any:
        memory, robot = carry
        control, memory, info = controller.step(
            memory, robot, belief, key=jax.random.fold_in(key, number)
        )
        robot = scenario.robot.step(robot, control, scenario.control_period)
        return (memory, robot), info.members.controls

    begin = state.controller, state.task.robot
    return jax.lax.scan(step, begin, jnp.arange(100))[1] / controller.members.half_range


@pytest.mark.parametrize("name", SCENARIOS)
def test_roles_plan_differently(made, name: str) -> None:
    """The diversity test of the design notes, for each pair of roles and each scenario."""
    controller, scenario, _, key = made[name]
    state = initial_loop_state(controller, scenario, key)
    belief = state.task.belief
    if name == "perimeter":
        # Where all is known, there is nothing to explore before a first look.
        look = eqx.filter_jit(lambda scenario, state, moment: scenario.perceive(state, moment, key))
        _, belief = look(scenario, state.task, moment_at(scenario, state, key))
    controls = np.asarray(plans(controller, scenario, state, belief, key))
    assert controls.shape[:2] == (100, 4)
    for one, other in itertools.combinations(range(controls.shape[1]), 2):
        away = np.sqrt(np.mean((controls[:, one] - controls[:, other]) ** 2, axis=-1))
        pair = controller.member_names[one], controller.member_names[other]
        assert away.mean() > 0.05, pair


def test_a_scenario_is_told_from_a_map_and_a_world(tmp_path: Path) -> None:
    for name in SCENARIOS:
        assert is_scenario_file(path_of(name))
    Path("world.yaml").write_text(yaml.safe_dump(SMALL["world"]))
    Path("list.yaml").write_text("- world")
    for name in ("world.yaml", "list.yaml", "gone.yaml"):
        assert not is_scenario_file(name)


# One's own

SMALL: dict[str, Any] = {
    "architecture": "portfolio",
    "start": [0.8, 1.6, 0.0],
    "time_limit": 0.4,
    "target_coverage": None,
    "world": {
        "size": [4.0, 3.2],
        "resolution": 0.2,
        "wall_reach": 0.2,
        "start": [0.8, 1.6, 0.0],
        "walls": [[0, 0, 4, 0], [4, 0, 4, 3.2], [4, 3.2, 0, 3.2], [0, 3.2, 0, 0]],
        "zones": [[2.4, 0.0, 4.0, 3.2]],
        "targets": [[3.2, 2.4], [3.2, 0.8]],
        "movers": [{"path": [[1.2, 0.8], [2.4, 0.8]], "speed": 0.5, "radius": 0.2}],
    },
    "lidar": {"num_beams": 24, "max_range": 1.5},
    "watch": {"memory": 10.0},
    "fields": {"num_directions": 4, "node_spacing": 0.2},
    "portfolio": {"members": ["explorer", "cautious"], "num_samples": 8, "horizon": 4},
}


def write(name: str, **changes: Any) -> str:
    """Write a scenario of one's own, with some entries or sections changed, and return its name."""
    entries = {**SMALL}
    for key, value in changes.items():
        is_section = isinstance(value, dict) and key != "weights"
        entries[key] = {**entries.get(key, {}), **value} if is_section else value
    Path(name).write_text(yaml.safe_dump(entries))
    return name


FILES = {
    "arrays.npz",
    "state.npz",
    "coverage.png",
    "explored.yaml",
    "explored.pgm",
    "map.png",
    "members.png",
    "metrics.json",
    "settings.yaml",
}


def test_a_scenario_of_one_s_own_runs_and_its_settings_repeat_it(capsys) -> None:
    name = write("yard.yaml")
    main(["run", name, "--seed", "5", "--no-animation"])
    folder = Path("runs/yard")
    assert {path.name for path in folder.iterdir()} == FILES
    main(["run", "--settings", str(folder / "settings.yaml"), "--out", "again", "--no-animation"])
    first, again = (np.load(each / "arrays.npz") for each in (folder, Path("again")))
    assert sorted(first.files) == sorted(again.files)
    for key in first.files:
        np.testing.assert_array_equal(first[key], again[key])
    metrics = [json.loads((each / "metrics.json").read_text()) for each in (folder, Path("again"))]
    for one in metrics:
        one.pop("compute")
    assert metrics[0] == metrics[1]
    assert metrics[0]["num_targets"] == 2
    assert metrics[0]["seed"] == 5
    assert list(metrics[0]["members"]) == ["explorer", "cautious"]
    used = yaml.safe_load((folder / "settings.yaml").read_text())
    assert used["world"]["targets"] == SMALL["world"]["targets"]
    assert used["map"] == str(Path(name).absolute())
    assert "targets" in capsys.readouterr().out


def test_a_scenario_runs_by_its_name(capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the file of one's own, as large a program as the one above, in place of its own."""
    asked = []

    def found(name: str) -> Path:
        asked.append(name)
        return Path("yard.yaml")

    write("yard.yaml")
    monkeypatch.setattr("jaxplore.tasks.exploration.settings.scenario_path", found)
    arguments = ["--time-limit", "0.2", "--samples", "8", "--no-animation"]
    main(["run", "warehouse", *arguments, "--out", "it"])
    assert set(asked) == {"warehouse"}
    assert {path.name for path in Path("it").iterdir()} == FILES
    metrics = json.loads(Path("it/metrics.json").read_text())
    assert metrics["num_steps"] == 10
    assert metrics["collisions"] == 0
    assert list(metrics["members"]) == ["explorer", "cautious"]
    shares = [member["share"] for member in metrics["members"].values()]
    assert sum(shares) == pytest.approx(1.0, abs=1e-4)
    used = yaml.safe_load(Path("it/settings.yaml").read_text())
    assert used["map"] == "warehouse"
    assert used["time_limit"] == 0.2
    assert str(Path("it") / "members.png") in capsys.readouterr().out


def test_options_win_over_a_scenario(asked: list[Any]) -> None:
    name = write("yard.yaml", map="my yard")
    options = ["--samples", "9", "--max-speed", "0.5", "--set", "portfolio.fusion=average"]
    for place in (name, "warehouse"):
        with pytest.raises(SystemExit):
            main(["run", place, *options, "--goal", "3", "2", "--set", "watch.weight=2"])
    for settings, title in zip(asked, ("my yard", "warehouse"), strict=True):
        assert settings.map == title
        assert settings.goal == (3.0, 2.0)
        assert settings.robot.max_speed == 0.5
        assert settings.portfolio.num_samples == 9
        assert settings.portfolio.fusion == "average"
        assert settings.watch.weight == 2.0
    # What else the scenario says of the section stays.
    assert asked[0].watch.memory == 10.0
    assert asked[0].portfolio.horizon == 4
    assert asked[1].robot.radius == 0.3


@pytest.mark.parametrize(
    ("fusion", "kind"),
    [
        ("weighted-vote", jx.planning.WeightedVote),
        ("best-only", jx.planning.BestOnly),
        ("average", jx.planning.Average),
        ("median", jx.planning.Median),
        ("trust-weighted", jx.planning.TrustWeighted),
        ("trust_weighted", jx.planning.TrustWeighted),
        ("information_density", jx.planning.InformationDensity),
        ("contextual", jx.planning.Contextual),
    ],
)
@pytest.mark.parametrize("is_safe", [True, False])
def test_fusions_by_name(fusion: str, kind: type, is_safe: bool) -> None:
    given = {"members": None, "fusion": fusion, "is_safe": is_safe, "num_samples": 4}
    settings = make_settings({**SMALL, "map": "yard", "portfolio": given})
    found = build(settings).controller.fusion
    if is_safe:
        assert isinstance(found, jx.planning.SafeFusion)
        found = found.fusion
    assert type(found) is kind


def test_words_have_two_spellings_in_settings(asked: list[Any]) -> None:
    for place, robot, fusion in (
        ("search-rescue", "differential_drive", "best-only"),
        ("search_rescue", "differential-drive", "best_only"),
    ):
        words = ["--set", f"robot.model={robot}", "--set", f"portfolio.fusion={fusion}"]
        with pytest.raises(SystemExit):
            main(["run", place, *words])
    assert asked[0] == asked[1]
    assert asked[1].robot.model == "differential_drive"
    assert asked[1].portfolio.fusion == "best-only"
    flights = [
        make_settings({"map": "zones", "architecture": word}) for word in ("two-layer", "two_layer")
    ]
    assert flights[0] == flights[1]
    with pytest.raises(ValueError, match=r"setting portfolio.fusion is 'best__only'; accepted"):
        make_settings({**SMALL, "map": "yard", "portfolio": {"fusion": "best__only"}})


def test_roles_of_members_of_one_s_own_in_settings() -> None:
    given = {
        "members": None,
        "weights": {"scout": {"information": 1.0}, "guard": {"safety": 1.0}},
        "fusion": "contextual",
        "roles": {"balanced": "guard", "explorer": "scout"},
        "is_safe": False,
    }
    found = build(make_settings({**SMALL, "map": "yard", "portfolio": given})).controller
    assert found.fusion.members == (0, 1, None, None)


@pytest.mark.parametrize(
    ("decomposition", "names"),
    [
        ("roles", ("explorer", "balanced", "exploiter", "cautious")),
        ("temporal", ("short", "middle", "long")),
        ("regional", ("left", "forward", "right")),
    ],
)
def test_decompositions_by_name(decomposition: str, names: tuple[str, ...]) -> None:
    given = {"decomposition": decomposition, "num_samples": 4, "horizon": 4}
    settings = make_settings({**SMALL, "map": "yard", "portfolio": given})
    assert build(settings).controller.member_names == names


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"portfolio": {"fusion": "vote"}}, "setting portfolio.fusion is 'vote'; accepted: 'weig"),
        (
            {"portfolio": {"decomposition": "spatial"}},
            "setting portfolio.decomposition is 'spatial'; accepted: 'roles'",
        ),
        ({"portfolio": {"members": ["explorer", "brave"]}}, "'brave'"),
        ({"portfolio": {"members": []}}, "members"),
        (
            {
                "portfolio": {
                    "members": None,
                    "weights": {"one": {"information": 0.0, "effort": 0.0}},
                }
            },
            "weights is",
        ),
        ({"portfolio": {"members": None, "weights": {"one": {"fame": 1.0}}}}, "'fame'"),
        (
            {"portfolio": {"members": None, "weights": {"one": {"information": -1.0}}}},
            "portfolio.weights.one.info",
        ),
        ({"portfolio": {"common": {"information": 0.0}}}, "common"),
        ({"portfolio": {"common": {"fame": 1.0}}}, "'fame'"),
        ({"portfolio": {"fusion": "contextual"}}, "names that include"),
        ({"portfolio": {"speed": 1.0}}, "unknown setting portfolio.speed; accepted here"),
        ({"watch": {"memory": 0.0}}, "setting watch.memory is 0.0"),
        ({"camera": {"tilt": 2.0}}, "tilt is 2.0"),
        ({"camera": {"wings": 2.0}}, "unknown setting camera.wings; accepted here: num_beams"),
        ({"robot": {"model": "ackermann", "length": 0.4}}, "setting robot.length is 0.4"),
        ({"goal": [3.9, 3.1]}, "goal is [3.9"),
        ({"goal": [9.0, 1.0]}, "goal is [9.0, 1.0]; accepted: a place in free space"),
        ({"world": {"targets": [[3.2, 2.4], [0.0, 0.0]]}}, "targets[1]"),
        ({"world": {"targets": [[3.2, 2.4], [9.0, 0.0]]}}, "targets[1]"),
        ({"world": {"wings": 2}}, "wings"),
        ({"world": {"movers": [{"path": [[1.0, 1.0]], "speed": -1.0, "radius": 0.2}]}}, "movers[0"),
        (
            {"returns": True, "goal": [3.2, 1.6]},
            "returns is true beside the goal [3.2, 1.6]; accep",
        ),
        ({"terrain": {"height_map": "hills.png"}}, "terrain.height_map is 'hills.png'"),
        ({"terrain": {"max_slope": 0.0}}, "setting terrain.max_slope is 0.0"),
        ({"start": [0.0, 0.0, 0.0]}, "in a wall"),
    ],
)
def test_bad_scenarios_are_one_line(fails, changes: dict[str, Any], reason: str) -> None:
    error = fails("run", write("yard.yaml", **changes), "--out", "out")
    assert reason in error


def test_a_member_that_is_to_weigh_nothing_is_refused() -> None:
    """Though effort has a weight of its own."""
    settings = make_settings(
        {**SMALL, "map": "yard", "portfolio": {"weights": {"one": {"information": 0.0}}}}
    )
    with pytest.raises(ValueError, match="weights"):
        build(settings)


@pytest.mark.parametrize("architecture", ["explorer", "portfolio"])
def test_a_robot_that_returns_has_its_start_as_its_goal_when_all_is_explored(architecture) -> None:
    world = {**SMALL["world"], "targets": [], "movers": []}
    home = {"returns": True, "architecture": architecture, "watch": None}
    entries = {**SMALL, "map": "yard", "world": world, **home}
    scenario = build(make_settings(without_unread(entries))).scenario
    assert scenario.goal.tolist() == scenario.start[:2].tolist()
    assert scenario.max_unknown == scenario.perception.max_unknown == 0.0
    # Guidance to the goal on its own would keep the robot near its start.
    assert not scenario.perception.is_goal_apart


def test_a_goal_that_cannot_be_reached_is_one_line(fails) -> None:
    name = write("yard.yaml", goal=[3.2, 1.6], goal_radius=0.3, world={"hidden": {
        "walls": [[2.0, 0.0, 2.0, 3.2]]
    }, "targets": [], "movers": []})  # fmt: skip
    error = fails("run", name, "--out", "out")
    assert "goal is [3.2" in error
    assert "cannot reach from its start" in error


# A ROS map with a height map


@pytest.fixture
def ros_map(tmp_path: Path) -> str:
    world = np.zeros((20, 30), np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 1.0, 1.0, 1.0, 1.0
    jx.OccupancyGrid(world, 0.2).to_ros(tmp_path / "map.yaml")
    return "map.yaml"


def hills(shape: tuple[int, int], name: str = "hills.png") -> str:
    """Write a height map that rises from black in the west to white in the east."""
    grey = np.tile(np.linspace(0, 255, shape[1]), (shape[0], 1))
    Image.fromarray(grey.astype(np.uint8)).save(name)
    return name


def test_a_height_map_is_the_ground_of_a_ros_map(ros_map: str) -> None:
    entries = {"map": ros_map, "start": (1.0, 2.0, 0.0), "resolution": 0.2}
    terrain = {"height_map": hills((20, 30)), "elevation_scale": 2.9, "max_slope": 2.0}
    scenario = build(make_settings({**entries, "terrain": terrain})).scenario
    elevation = np.asarray(scenario.ground.elevation)
    np.testing.assert_allclose(elevation[:, 0], 0.0, atol=1e-6)
    np.testing.assert_allclose(elevation[:, -1], 2.9, rtol=1e-5)
    np.testing.assert_allclose(np.asarray(scenario.ground.slope).mean(), 0.5, atol=0.03)
    assert build(make_settings(entries)).scenario.ground is None


@pytest.mark.parametrize(
    ("height_map", "reason"),
    [((20, 31), "hills.png"), ((10, 15), "hills.png"), (None, "gone.png")],
)
def test_a_height_map_of_another_size_is_one_line(ros_map, fails, height_map, reason) -> None:
    name = "gone.png" if height_map is None else hills(height_map)
    start = ["--start", "1", "2", "0", "--resolution", "0.2"]
    setting = ["--set", f"terrain.height_map={name}"]
    assert reason in fails("run", ros_map, *start, *setting, "--out", "out")
