"""The reference of settings agrees with the settings, with what runs read and with controllers."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

import jaxplore as jx
from jaxplore.settings.defaults import DIFFERENCES
from jaxplore.settings.readers import given_leaves, read_values
from jaxplore.settings.sections import Section, section_class
from jaxplore.tasks.commented_yaml import to_commented_yaml
from jaxplore.tasks.exploration.settings import ExplorationSettings
from jaxplore.tasks.path.settings import PathFollowingSettings
from jaxplore.tasks.reference import (
    Row,
    classes,
    controller_parameter,
    find_rows,
    place_settings,
    rows,
    sections,
    setting_names,
)
from jaxplore.tasks.registry import build, keep_read, make_settings, places
from jaxplore.tasks.volume.settings import GENERATED, VolumeExplorationSettings


def row_of(name: str, task: str = "exploration") -> Row:
    (row,) = (each for each in find_rows(name) if each.task == task)
    return row


def test_every_setting_has_one_row_with_a_meaning() -> None:
    def names(task, section, prefix=""):
        for name, field in section.model_fields.items():
            inner = section_class(field.annotation)
            if inner is None:
                yield task, prefix + name
            else:
                assert sections()[task, prefix + name]
                yield from names(task, inner, f"{prefix}{name}.")

    expected = [each for task, kind in classes().items() for each in names(task, kind)]
    assert [(row.task, row.name) for row in rows()] == expected
    for row in rows():
        assert row.meaning
        assert row.accepted
        assert row.reader.text


def test_a_row_says_what_is_known() -> None:
    row = row_of("lidar.max_range")
    assert row.meaning.startswith("greatest range [m]; static")
    assert row.short_meaning.startswith("greatest range; static")
    assert (row.unit, row.default, row.owner) == ("m", 5.0, "Lidar")
    assert (row.accepted, row.read_by) == ("number in (0, 10000]", "every run")
    assert row.notes == (
        "Quadrotors: 4.0, a depth camera, from the design notes.",
        "warehouse: 8.0; search-rescue: 8.0; perimeter: 8.0.",
    )
    note = "`Ackermann` has 0.5; here: a race car of F1TENTH's size."
    assert row_of("robot.wheelbase", "path").notes == (note,)
    assert row_of("terrain.threshold").unit is None
    assert row_of("map").is_required
    assert row_of("camera.num_beams").read_by == "runs with camera (search-rescue)"
    assert row_of("robot.mass", "path").read_by == "no run"
    assert row_of("informative.depleted").read_by == "sequential (not by default)"


def test_a_setting_in_degrees_says_that_its_owner_takes_radians() -> None:
    in_degrees = [row for row in rows() if row.name.endswith("_degrees")]
    assert len(in_degrees) == 19
    for row in in_degrees:
        assert row.unit == "degrees"
        if row.owner is None:
            assert "[degrees]" in row.meaning
            continue
        assert "[rad]" in row.meaning
        assert row.meaning.endswith(f" In degrees; `{row.owner}` takes radians.")


@pytest.mark.parametrize(
    ("name", "task", "accepted"),
    [
        ("lidar.field_of_view_degrees", "exploration", "number in (0, 360]"),
        ("seed", "exploration", "whole number in [0, 4294967296)"),
        ("sensor_model.free", "exploration", "number < 0"),
        ("sensor_model.kind", "exploration", "one of log_odds, line_of_sight"),
        ("robot.min_speed", "exploration", "number"),
        ("watch.memory", "exploration", "number > 0 or null"),
        ("portfolio.is_safe", "exploration", "true or false"),
        ("portfolio.members", "exploration", "list of text or null"),
        ("world", "exploration", "mapping or null"),
        ("parameters", "exploration", "mapping of names to number or list of number"),
        ("controller.noise_std", "exploration", "list of number > 0 or null"),
        ("obstacles.discs", "path", "list of [number, number, number > 0]"),
        ("controller.risk_level", "path", "number in [0, 1) or null"),
    ],
)
def test_accepted_values_are_words(name: str, task: str, accepted: str) -> None:
    assert row_of(name, task).accepted == accepted


def test_every_difference_is_in_a_note() -> None:
    for key, difference in DIFFERENCES.items():
        kind, _, name = key.partition(".")
        row = row_of(name, kind if kind in classes() else "exploration")
        assert any(difference.reason in note for note in row.notes), key


# Who reads a setting

MAP = {"map": "map.yaml", "start": (1.5, 1.5, 0.0), "resolution": 0.1}
FOREST = {"volume": "forest", "generated": {"size": (8.0, 6.0, 2.4)}, "resolution": 0.2}
CASES: dict[str, dict[str, Any]] = {
    **{place: {"map": place} for place in places()},
    # Small, because what is read does not depend on the size. A maze has two storeys.
    **{
        place: {**FOREST, "volume": place, "generated": {"size": (8.0, 6.0, height)}}
        for place, height in {**dict.fromkeys(GENERATED, 2.4), "maze3d": 5.6}.items()
    },
    "a rule": {"map": "office", "architecture": "wander"},
    **{
        name: {"map": "zones", "architecture": name}
        for name in ("explorer", "portfolio", "parallel", "sequential", "random-walk", "goal")
    },
    "flying in a building": {"map": "office", "architecture": "two-layer"},
    "a quadrotor that explores": {"map": "zones", "robot": {"model": "quadrotor"}},
    "a unicycle": {"map": "office", "robot": {"model": "unicycle"}},
    "an omnidirectional robot": {"map": "office", "robot": {"model": "omnidirectional"}},
    "a line of sight": {"map": "office", "sensor_model": {"kind": "line_of_sight"}},
    "contextual": {"map": "warehouse", "portfolio": {"fusion": "contextual"}},
    "unsafe": {"map": "warehouse", "portfolio": {"fusion": "median", "is_safe": False}},
    "weights": {"map": "warehouse", "portfolio": {"weights": {"one": {"information": 1.0}}}},
    "a ROS map": MAP,
    "a height map": {**MAP, "terrain": {"height_map": "heights.png"}},
    "a world file": {"map": "room.yaml"},
    "a path file": {"path": "path.csv", "half_width": 1.0},
    "traffic": {"path": "track", "obstacles": {"number": 2}},
    "discs": {"path": "track", "obstacles": {"discs": [[0.0, 0.0, 0.1]]}},
    "a bicycle along a path": {"path": "track", "robot": {"model": "bicycle"}},
    "a volume file": {"volume": "room.npy", "resolution": 0.2},
    "rules in a volume": {**FOREST, "architecture": "nearest-cluster"},
    "two-layer in a volume": {**FOREST, "architecture": "two-layer"},
    "a lidar in a volume": {**FOREST, "camera": None, "lidar": {}},
    "a robot along a path": {"path": "track", "robot": {"model": "differential_drive"}},
}


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Return the names of the settings that are read from now on."""
    prefixes: dict[type, str] = {}
    for kind in (ExplorationSettings, PathFollowingSettings, VolumeExplorationSettings):
        prefixes[kind] = ""
        for name, field in kind.model_fields.items():
            inner = section_class(field.annotation)
            if inner is not None:
                prefixes[inner] = f"{name}."
    found: set[str] = set()

    def noting(section: Section, name: str) -> Any:
        kind = type(section)
        if kind in prefixes and name in kind.__dict__["__pydantic_fields__"]:
            found.add(prefixes[kind] + name)
        return object.__getattribute__(section, name)

    monkeypatch.setattr(Section, "__getattribute__", noting)
    return found


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write a ROS map with heights, a world and a path into the current folder."""
    monkeypatch.chdir(tmp_path)
    world = np.zeros((40, 40), np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 1.0, 1.0, 1.0, 1.0
    jx.OccupancyGrid(world, 0.1).to_ros("map.yaml")
    Image.new("L", (40, 40)).save("heights.png")
    room = {"size": [4.0, 3.0], "resolution": 0.2, "start": [1.0, 1.5, 0.0]}
    Path("room.yaml").write_text(yaml.safe_dump(room))
    solid = np.zeros((8, 12, 12), bool)
    solid[[0, -1]] = solid[:, [0, -1]] = solid[:, :, [0, -1]] = True
    np.save("room.npy", solid)
    angle = np.linspace(0.0, 2.0 * np.pi, 40)
    np.savetxt("path.csv", 6.0 * np.stack([np.cos(angle), np.sin(angle)], 1), delimiter=",")


NOT_READ_BY_BUILDING = {"map", "world", "path", "volume", "architecture", "goal"}
"""Settings that choose what is built: whether one is read depends on another of them."""


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize("case", CASES)
def test_what_a_run_reads_is_what_the_reference_says(case: str, read: set[str]) -> None:
    settings = make_settings(CASES[case])
    known = [row for row in rows() if classes()[row.task] is type(settings)]
    expected = {row.name for row in known if row.reader.reads(settings)}
    read.clear()
    build(settings)
    found = {name for name in read if name in set(setting_names())}
    assert found - NOT_READ_BY_BUILDING == expected - NOT_READ_BY_BUILDING
    # What is read is accepted, and what is not is refused.
    assert make_settings({**CASES[case], **read_values(settings)}) == settings
    values = settings.model_dump()
    given = dict(given_leaves(type(settings), values))
    other = next(
        name for name in (row.name for row in known)
        if name not in expected and given.get(name) is not None
    )  # fmt: skip
    section, _, last = other.partition(".")
    before = CASES[case].get(section) or {}
    wrong = {section: {**before, last: values[section][last]} if last else values[section]}
    with pytest.raises(ValueError, match=rf"^setting {other} is .* does not read"):
        make_settings({**CASES[case], **wrong})


def test_runs_that_are_compared_accept_what_one_of_them_reads() -> None:
    common = {"map": "office", "portfolio": {"horizon": 9}, "controller": {"horizon": 8}}
    kept = keep_read({name: {**common, "architecture": name} for name in ("explorer", "portfolio")})
    assert kept["explorer"] == {
        "map": "office",
        "architecture": "explorer",
        "controller": {"horizon": 8},
    }
    assert kept["portfolio"]["portfolio"] == {"horizon": 9}
    assert "controller" not in kept["portfolio"]
    # What one of them has alone, it must read itself.
    with pytest.raises(ValueError, match=r"^setting portfolio.horizon is 9, which arch"):
        keep_read({"explorer": common, "portfolio": {"map": "office", "architecture": "portfolio"}})
    with pytest.raises(ValueError, match=r"controller.horizon is 8, which architecture two-layer"):
        keep_read({name: {"map": "zones", "architecture": name, "controller": {"horizon": 8}}
                   for name in ("two-layer", "goal")})  # fmt: skip


# Names of parameters


def changed_parameters(place: dict[str, Any], name: str, path: str) -> tuple[str, dict[str, Any]]:
    """Return the full path of a parameter, and the parameters that change with a setting."""
    section, _, last = name.partition(".")
    before = make_settings(place)
    after = make_settings({**place, section: {last: 2.0 * getattr(getattr(before, section), last)}})
    old, new = (build(each).controller for each in (before, after))
    parameters = jx.get_parameters(old)
    changed = {
        each: np.asarray(value)
        for each, value in jx.get_parameters(new).items()
        if not np.array_equal(value, parameters[each])
    }
    return jx.find_parameter(old, path), changed


PARAMETERS = {
    "explorer": ("exploration", {"map": "office"}, "controller."),
    "portfolio": ("exploration", {"map": "warehouse"}, "portfolio."),
    "two-layer": ("exploration", {"map": "zones"}, "informative."),
    "path": ("path", {"path": "track"}, "controller."),
}


@pytest.mark.parametrize("case", PARAMETERS)
def test_a_setting_sets_the_parameter_that_its_row_names(case: str) -> None:
    task, place, prefix = PARAMETERS[case]
    step = make_settings(place).controller.dt
    tried = 0
    for row in rows():
        path = controller_parameter(row.owner, row.name.rpartition(".")[2])
        if row.task != task or not row.name.startswith(prefix) or path is None:
            continue
        tried += 1
        full, changed = changed_parameters(place, row.name, path)
        assert set(changed) == {full}
        (note,) = (each for each in row.notes if "controller parameter" in each)
        scale = step if "times `dt`" in note else 1.0
        assert float(changed[full]) == pytest.approx(2.0 * scale * row.default)
    assert tried == {"explorer": 5, "path": 5}.get(case, 1)


# YAML with comments


@pytest.mark.parametrize("place", places())
def test_the_yaml_with_comments_is_read_as_equal_settings(place: str) -> None:
    text = to_commented_yaml(place_settings(place))
    assert make_settings(yaml.safe_load(text)) == make_settings({"map": place})
    lines = text.splitlines()
    assert max(map(len, lines)) <= 100
    assert lines[0].startswith("# ")
    for name in read_values(make_settings({"map": place})):
        where = next(i for i, line in enumerate(lines) if line.startswith(f"{name}:"))
        assert lines[where - 1].startswith("# "), name


def test_the_yaml_has_what_a_run_reads_and_nothing_else() -> None:
    text = to_commented_yaml(place_settings("zones"))
    given = yaml.safe_load(text)
    assert {"controller", "portfolio", "office", "map_file", "resolution"}.isdisjoint(given)
    assert "mass" in given["robot"]
    assert "max_turn_rate" not in given["robot"]
    assert "# Its settings: jaxplore settings camera.\ncamera: null" in text
    informative = text[: text.index("\ninformative:")].rpartition("\n\n")[2]
    assert informative == "# settings of informative MPPI and of its baselines."
