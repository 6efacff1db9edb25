"""Every number that a user gives has bounds, and what a run needs is estimated before it starts."""

import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest
from pydantic import BaseModel

import jaxplore as jx
from jaxplore import _checks
from jaxplore._limits import LARGEST, MOST_SEEDS
from jaxplore.cli._tune import parse_budget
from jaxplore.maps.files.images import image_size, read_greys
from jaxplore.maps.files.ros import map_size
from jaxplore.maps.padding import choose_padded_shape
from jaxplore.settings.sections import RunSettings, section_class
from jaxplore.simulation.chunks import MAX_FRAMES, are_too_many
from jaxplore.study.seeds import check_number_of_runs, check_number_of_seeds
from jaxplore.study.tuning.search import Measure
from jaxplore.tasks.exploration.memory import estimate_exploration
from jaxplore.tasks.exploration.pilot import make_node_settings
from jaxplore.tasks.memory import Part, check_needs
from jaxplore.tasks.memory_limit import SHARE, default_limit
from jaxplore.tasks.reference import classes
from jaxplore.tasks.registry import kind_of, make_settings

BILLION = 1_000_000_000


def needs(settings: RunSettings) -> tuple[Part, ...]:
    """Estimate the memory of a run, part by part."""
    return kind_of(settings).needs(settings, math.inf)


FREE = {"world", "variation.parameters.*"}
"""Entries whose sizes are checked elsewhere: those of a world."""


def leaves(schema: dict[str, Any], name: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the schemas of numbers and of lists and mappings of any length inside of a schema."""
    for inner in schema.get("anyOf", ()):
        yield from leaves(inner, name)
    kind = schema.get("type")
    if kind in ("number", "integer"):
        yield name, schema
    if kind == "array":
        if "prefixItems" in schema:
            for inner in schema["prefixItems"]:
                yield from leaves(inner, name)
        else:
            yield name, schema
            yield from leaves(schema["items"], name)
    if kind == "object":
        yield name, schema
        if isinstance(schema.get("additionalProperties"), dict):
            yield from leaves(schema["additionalProperties"], name)


def settings_leaves(section: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, Any]]:
    properties = section.model_json_schema()["properties"]
    for name, field in section.model_fields.items():
        inner = section_class(field.annotation)
        if inner is not None:
            yield from settings_leaves(inner, f"{prefix}{name}.")
        else:
            yield from leaves(properties[name], prefix + name)


@pytest.mark.parametrize("kind", classes())
def test_every_number_and_every_length_of_the_settings_has_a_bound(kind: str) -> None:
    found = list(settings_leaves(classes()[kind]))
    assert len(found) > 20
    for name, schema in found:
        if name in FREE:
            continue
        if schema["type"] in ("number", "integer"):
            assert {"maximum", "exclusiveMaximum"} & set(schema), name
            assert {"minimum", "exclusiveMinimum"} & set(schema), name
            assert abs(schema.get("maximum", 0.0)) <= LARGEST, name
        else:
            assert {"maxItems", "maxProperties"} & set(schema), name


@pytest.mark.parametrize(
    ("entries", "culprit"),
    [
        ({"controller": {"num_samples": BILLION}}, "controller.num_samples is 1000000000"),
        ({"controller": {"horizon": BILLION}}, "controller.horizon is 1000000000"),
        ({"lidar": {"max_range": 1e9}}, "lidar.max_range is 1000000000.0"),
        ({"lidar": {"num_beams": BILLION}}, "lidar.num_beams is 1000000000"),
        ({"fields": {"num_directions": BILLION}}, "fields.num_directions is 1000000000"),
        ({"resolution": 1e-9}, "resolution is 1e-09; accepted: greater than or equal to 0.001"),
        ({"time_limit": 1e20}, "time_limit is 1e[+]20; accepted: less than or equal to"),
        ({"rates": {"control": 1e12}}, "rates.control is"),
        (
            {"controller": {"temperature": 1e-300}},
            "controller.temperature is 1e-300; accepted: at least",
        ),
        ({"controller": {"guidance_weight": 1e300}}, "controller.guidance_weight is 1e[+]300"),
        ({"start": [1e300, 0.0, 0.0]}, "start.0 is 1e[+]300"),
        ({"parameters": {"smoothing.x": 1e300}}, "parameters.smoothing.x is"),
        ({"parameters": {str(i): 1.0 for i in range(2000)}}, "parameters is"),
        (
            {"controller": {"noise_std": [1.0] * 2000}},
            "controller.noise_std is .*; accepted: at most 1000 entries",
        ),
        ({"portfolio": {"weights": {str(i): {} for i in range(200)}}}, "portfolio.weights is"),
        ({"latency": 1e9}, "latency is"),
        (
            {"variation": {"gain": 0.5}},
            r"variation.gain is 0.5; accepted: \[number > 0, number > 0\]$",
        ),
        ({"faults": {"control_delay": BILLION}}, "faults.control_delay is"),
        ({"map": None, "path": "track", "track": {"num_bends": 10**6}}, "track.num_bends is"),
        ({"map": None, "path": "track", "laps": 10**20}, "laps is"),
        ({"map": None, "path": "track", "obstacles": {"number": BILLION}}, "obstacles.number is"),
        (
            {"map": None, "path": "track", "obstacles": {"discs": [[0.0, 0.0, 1.0]] * 2000}},
            "obstacles.discs is",
        ),
    ],
)
def test_an_absurd_setting_is_refused_by_its_name(entries: dict[str, Any], culprit: str) -> None:
    given = {name: each for name, each in {"map": "office", **entries}.items() if each is not None}
    with pytest.raises(ValueError, match=f"^setting {culprit}") as caught:
        make_settings(given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "entries",
    [
        {"resolution": 0.01},
        {"time_limit": 1e5},
        {"controller": {"num_samples": 100_000}},
        {"controller": {"horizon": 1_000, "dt": 0.001}},
        {"lidar": {"num_beams": 4_096}},
        {"lidar": {"max_range": 300.0}},
        {"fields": {"num_directions": 720}},
        {"office": {"width": 400.0, "height": 40.0}, "resolution": 0.05},
        {"map": None, "path": "track", "track": {"length": 10_000.0}, "laps": 1_000},
        {"map": None, "path": "track", "controller": {"num_samples": 100_000, "horizon": 1_000}},
    ],
)
def test_what_people_use_is_accepted_and_fits_into_16_gigabytes(entries: dict[str, Any]) -> None:
    given = {name: each for name, each in {"map": "office", **entries}.items() if each is not None}
    check_needs(needs(make_settings(given)), 16e9)


def test_maps_of_4000_x_4000_cells_fit_into_16_gigabytes(tmp_path: Path) -> None:
    file = ros_map(tmp_path, 4_000, 0.05)
    check_needs(needs(make_settings({"map": file, "resolution": 0.05})), 16e9)


@pytest.mark.parametrize(
    "make",
    [
        lambda: jx.office(width=300.0, height=300.0),
        lambda: Measure("coverage", 0.0, 1.0, 10**9),
        lambda: check_number_of_seeds("seeds", range(BILLION)),
        lambda: check_number_of_seeds("seeds", range(10**18)),
        lambda: check_number_of_seeds("seeds", range(2**32 - 1, 2**32 + 1)),
        lambda: check_number_of_runs(BILLION),
        lambda: parse_budget(str(BILLION)),
        lambda: parse_budget("9" * 5000),
        lambda: parse_budget("9" * 400 + "h"),
        lambda: _checks.positive_int("n", 10**5000, at_most=7),
    ],
)
@pytest.mark.filterwarnings("ignore:max_range is")
def test_a_size_in_python_is_refused_in_one_line(make: Any) -> None:
    with pytest.raises(ValueError, match="accepted: ") as caught:
        make()
    assert len(str(caught.value).splitlines()) == 1


def test_the_bound_that_is_violated_is_named() -> None:
    with pytest.raises(ValueError, match=r"^n is 8; accepted: a whole number <= 7$"):
        _checks.positive_int("n", 8, at_most=7)
    with pytest.raises(ValueError, match=r"^n is 0; accepted: a whole number >= 1$"):
        _checks.positive_int("n", 0, at_most=7)
    assert _checks.positive_int("n", 7, at_most=7) == 7


def ros_map(folder: Path, side: int, resolution: float) -> str:
    jx.OccupancyGrid(np.zeros((side, side), np.float32), resolution).to_ros(folder / "map.yaml")
    return str(folder / "map.yaml")


def size_of(entries: dict[str, Any]) -> float:
    return sum(part.size for part in needs(make_settings({"time_limit": 0.2, **entries})))


MEASURED: tuple[tuple[dict[str, Any], float], ...] = (
    # Peak memory of processes of `jaxplore run --no-animation` on a CPU [GB].
    ({"map": "office", "time_limit": 1.0}, 0.72),
    ({"map": "office", "controller": {"num_samples": 10_000}}, 0.78),
    ({"map": "office", "controller": {"num_samples": 100_000}}, 0.72),
    ({"map": "office", "controller": {"num_samples": 100_000, "horizon": 400}}, 1.30),
    ({"map": "office", "office": {"width": 100, "height": 100}}, 1.08),
    (
        {
            "map": "office",
            "office": {"width": 100, "height": 100},
            "fields": {"num_directions": 128},
        },
        1.52,
    ),
    ({"map": "office", "office": {"width": 100, "height": 100}, "resolution": 0.05}, 1.62),
    ({"map": "office", "office": {"width": 200, "height": 200}}, 1.95),
    ({"map": "office", "lidar": {"max_range": 50}}, 0.77),
    ({"path": "track", "controller": {"num_samples": 100_000}}, 0.62),
    ({"map": "zones", "informative": {"num_samples": 100_000}}, 1.23),
    ({"map": "m4000", "resolution": 0.05}, 3.36),
    ({"map": "m4000", "resolution": 0.1, "time_limit": 3.0}, 2.85),
)


@pytest.mark.parametrize(("entries", "measured"), MEASURED)
def test_a_run_takes_between_half_and_twice_the_estimate(entries, measured, tmp_path) -> None:
    if entries.get("map") == "m4000":
        entries = {**entries, "map": ros_map(tmp_path, 4_000, 0.05)}
    assert 0.5 <= size_of(entries) / 1e9 / measured <= 2.0


@pytest.mark.parametrize(
    ("section", "name", "value", "part"),
    [
        ("controller", "num_samples", 1_000_000, "controller"),
        ("controller", "horizon", 10_000, "controller"),
        ("lidar", "num_beams", 100_000, "beams"),
        ("lidar", "max_range", 10_000.0, "fields"),
        ("fields", "num_directions", 1_000, "fields"),
        ("office", "width", 10_000.0, "map"),
        ("rates", "control", 10_000.0, "record"),
    ],
)
def test_what_grows_is_the_part_of_the_setting(section, name, value, part: str) -> None:
    def parts(entries: dict[str, Any]) -> dict[str, float]:
        found = needs(make_settings({"map": "office", **entries}))
        assert any(f"{section}.{name}" in each.settings for each in found if each.name == part)
        return {each.name: each.size for each in found}

    before, after = parts({}), parts({section: {name: value}})
    assert after[part] > 2.0 * before[part]
    assert all(after[each] >= before[each] for each in before)


def test_the_belief_fits_into_the_estimate() -> None:
    """The shapes of the belief are an oracle for the cells, the nodes and the directions."""
    side, resolution = 300, 0.1
    rows, columns = choose_padded_shape((side, side))
    grid = jx.OccupancyGrid(np.full((rows, columns), 0.5, np.float32), resolution)
    for directions in (32, 128):
        perception = jx.Perception(jx.Lidar(), resolution, 0.2, num_directions=directions)
        belief = eqx.filter_eval_shape(perception.init, grid, jax.numpy.zeros(3))
        held = sum(
            each.size * each.dtype.itemsize
            for each in jax.tree.leaves(eqx.filter(belief, lambda leaf: hasattr(leaf, "size")))
        )
        settings = make_settings(
            {
                "map": "office",
                "office": {"width": 0.1 * side, "height": 0.1 * side},
                "fields": {"num_directions": directions},
            }
        )
        parts = {part.name: part.size for part in needs(settings)}
        # The loop holds the belief before and after an update, and what it is computed from.
        assert 1.5 * held <= parts["map"] + parts["fields"] <= 20.0 * held


def test_the_size_of_a_ros_map_is_that_of_its_resampled_cells(tmp_path: Path) -> None:
    file = ros_map(tmp_path, 400, 0.05)
    assert map_size(file) == (400, 400, 0.05)
    (coarse, fine) = (
        next(
            p.size for p in needs(make_settings({"map": file, "resolution": r})) if p.name == "map"
        )
        for r in (0.1, 0.05)
    )
    assert 3.0 < fine / coarse < 4.5


def test_the_size_of_an_image_is_read_without_its_pixels(tmp_path: Path) -> None:
    ros_map(tmp_path, 400, 0.05)
    image = tmp_path / "map.pgm"
    assert image_size(image) == read_greys(image).level.shape == (400, 400)
    image.write_bytes(image.read_bytes()[:100])
    assert image_size(image) == (400, 400)


def test_a_run_beyond_the_limit_is_refused() -> None:
    parts = needs(make_settings({"map": "office"}))
    total = sum(part.size for part in parts)
    check_needs(parts, total)
    with pytest.raises(ValueError, match=r"^the run needs about .* GB, .* GB of it for the"):
        check_needs(parts, 0.99 * total)
    with pytest.raises(ValueError, match=r"^3 runs at a time need about .*[(]--memory-limit[)]$"):
        check_needs(parts, 2.9 * total, num_runs=3)
    # The runs of a batch share their program.
    check_needs(parts, 2.9 * total, batch=3)
    with pytest.raises(ValueError, match="100 runs at a time need"):
        check_needs(parts, 2.9 * total, batch=100)


def test_a_drive_needs_a_map_of_its_own_size() -> None:
    small, large = (
        sum(part.size for part in estimate_exploration(settings, node=node))
        for settings, node in (
            make_node_settings({"node": {"map_size": size}}) for size in (50.0, 400.0)
        )
    )
    assert small < 1.5e9 < 4e9 < large


def test_the_default_limit_is_a_share_of_what_is_free(tmp_path: Path) -> None:
    assert 0.0 < default_limit() < 1e15

    def write(name: str, text: str) -> None:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)

    write("proc/meminfo", "MemTotal: 16000000 kB\nMemAvailable: 8000000 kB\n")
    assert default_limit(tmp_path) == SHARE * 8_000_000 * 1024
    write("proc/self/cgroup", "0::/jobs/mine\n")
    write("sys/fs/cgroup/jobs/mine/memory.max", "max\n")
    write("sys/fs/cgroup/jobs/memory.max", "4000000000\n")
    write("sys/fs/cgroup/jobs/memory.current", "1500000000\n")
    write("sys/fs/cgroup/jobs/memory.stat", "anon 1\ninactive_file 500000000\n")
    # Cached files are given up when memory is needed.
    assert default_limit(tmp_path) == SHARE * 3e9
    write("proc/self/cgroup", "5:cpu:/\n7:memory:/docker/abc\n")
    write("sys/fs/cgroup/memory/memory.limit_in_bytes", "2000000000\n")
    write("sys/fs/cgroup/memory/memory.usage_in_bytes", "500000000\n")
    assert default_limit(tmp_path) == SHARE * 1.5e9
    write("sys/fs/cgroup/memory/memory.limit_in_bytes", "9223372036854771712\n")
    assert default_limit(tmp_path) == SHARE * 8_000_000 * 1024


OFFICE = ["office", "--no-animation"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", *OFFICE, "--memory-limit", "0.5"], "the run needs about"),
        (["run", *OFFICE, "--memory-limit", "0"], "--memory-limit is 0.0; accepted: a number > 0"),
        (["run", *OFFICE, "--memory-limit", "nan"], "--memory-limit is nan; accepted"),
        (
            ["run", *OFFICE, "--set", f"controller.horizon={BILLION}"],
            "accepted: less than or equal",
        ),
        (["run", *OFFICE, "--range", "10000"], "GB of it for the fields"),
        (["run", *OFFICE, "--time-limit", "1e8"], "GB of it for the record (time_limit"),
        (["compare", *OFFICE, "--memory-limit", "0.5"], "the run needs about"),
        (
            ["compare", *OFFICE, "--seeds", str(BILLION)],
            f"accepted: a whole number <= {MOST_SEEDS}",
        ),
        (["compare", *OFFICE, "--workers", "10000"], "10000 runs at a time need about"),
        (["compare", *OFFICE, "--workers", str(BILLION)], "--workers is"),
        (["tune", *OFFICE, "--tune", "x", "--memory-limit", "0.5"], "the run needs about"),
        (["tune", *OFFICE, "--tune", "x", "--seeds", str(BILLION)], "--seeds is"),
        (["tune", *OFFICE, "--tune", "x", "--unseen", str(BILLION)], "--unseen is"),
        (["tune", *OFFICE, "--tune", "x", "--population", str(BILLION)], "--population is"),
        (["tune", *OFFICE, "--tune", "x", "--batch", str(BILLION)], "--batch is"),
        (["tune", *OFFICE, "--tune", "x", "--budget", str(BILLION)], "--budget is"),
        (
            ["tune", *OFFICE, "--tune", f"controller.num_samples=1:{BILLION}:log"],
            "setting controller.num_samples is 1000000000; accepted: less than",
        ),
        (
            [
                *("tune", *OFFICE, "--tune", "controller.num_samples=1000000,999999"),
                *("--tune", "controller.horizon=10:10000"),
            ],
            "the run needs about 161 GB",
        ),
        (["node", "--set", "node.map_size=100000"], "of it for the"),
        (["replay", "bag", "--set", "node.map_size=100000"], "of it for the"),
        (["robot", "office", "--memory-limit", "0.5"], "the run needs about"),
        (["robot", "office", "--delay", "1e9"], "--delay is"),
        (["robot", "office", "--mount", "11", "0", "0"], "--mount is 11 0 0; accepted: at most 10"),
        (["robot", "office", "--mount", "0", "nan", "0"], "--mount is 0 nan 0; accepted: at most"),
        (["robot", "office", "--mount", "0", "0", "inf"], "--mount is 0 0 inf; accepted: at most"),
    ],
)
def test_the_command_line_refuses_in_one_line(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch, fails
) -> None:
    monkeypatch.chdir(tmp_path)
    # Nothing is built before the refusal.
    for each in itertools.product(["_run", "_node", "_comparison"], ["build"]):
        monkeypatch.delattr(f"jaxplore.cli.{each[0]}.{each[1]}", raising=False)
    assert said in fails(*arguments)


def test_too_large_a_map_among_many_is_refused(tmp_path: Path, monkeypatch, fails) -> None:
    monkeypatch.chdir(tmp_path)
    ros_map(tmp_path, 1000, 0.1)
    assert "of it for the" in fails("compare", "--maps", str(tmp_path), "--memory-limit", "1")


def test_frames_of_a_large_map_are_few() -> None:
    class Shown:
        def __init__(self, size: int) -> None:
            self.values = np.broadcast_to(np.float32(0.0), (size,))

    small, large = Shown(1_000), Shown(10_000_000)
    assert not are_too_many([small] * MAX_FRAMES)
    assert are_too_many([small] * (MAX_FRAMES + 1))
    assert not are_too_many([large] * 25)
    assert are_too_many([large] * 26)
    # Those of a batch count together, and the first and the last are always kept.
    assert are_too_many([(large, large)] * 13)
    assert not are_too_many([Shown(10**9)] * 2)
