import contextlib
import dataclasses
import errno
import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

from jaxplore.parts.targets.report import TargetMetrics
from jaxplore.parts.watch.report import WatchMetrics
from jaxplore.report.compute import Compute
from jaxplore.report.drawing.film import FilmOptions
from jaxplore.report.exploration.evaluation import compute_metrics
from jaxplore.report.exploration.metrics import ExplorationMetrics
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.study.comparison import comparison as module
from jaxplore.study.comparison.comparison import Comparison, curves_figure

Make = Callable[..., tuple[ExplorationMetrics, ...]]

LATE = math.inf
# Times and, worked out by hand, what a quarter, a half and three quarters of the runs take.
QUARTILES = [
    ([7.0], (7.0, 7.0, 7.0), "7.0"),
    ([20.0, 10.0], (12.5, 15.0, 17.5), "15.0 [12.5, 17.5]"),
    ([30.0, 10.0, 40.0, 20.0], (17.5, 25.0, 32.5), "25.0 [17.5, 32.5]"),
    ([50.0, 10.0, 40.0, 20.0, 30.0], (20.0, 30.0, 40.0), "30.0 [20.0, 40.0]"),
    # A run that does not end is the last one, and only what it reaches up to is late.
    ([None, 10.0, 40.0, 20.0, 30.0], (20.0, 30.0, 40.0), "30.0 [20.0, 40.0]"),
    ([10.0, None, 30.0, None, 20.0], (20.0, 30.0, LATE), "30.0 [20.0, -]"),
    ([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, None, None], (3.0, 5.0, 7.0), "5.0 [3.0, 7.0]"),
    # Between two runs it is the later one that counts as soon as one of all did not end.
    ([None, 10.0, 20.0, 30.0], (20.0, 30.0, LATE), "30.0 [20.0, -]"),
    ([10.0, None], (LATE, LATE, LATE), "-"),
    ([None, None, None], (LATE, LATE, LATE), "-"),
]


@pytest.fixture
def make(recording: ExplorationRecording) -> Make:
    """Return a maker of runs that differ in what is given: for each name a value per run."""
    base = compute_metrics(recording, seed=0)

    def make(**columns: list[Any]) -> tuple[ExplorationMetrics, ...]:
        rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        return tuple(dataclasses.replace(base, **row) for row in rows)

    return make


@pytest.fixture
def comparison(make: Make, make_recording: Callable[..., ExplorationRecording]) -> Comparison:
    """Two controllers of which one does not get there, with a short recording of each."""
    short = make_recording([(0.5, 1.0), (1.0, 1.0)], [0.2], num_frames=2)
    runs = {
        "two-layer": make(finished_at=[3.0, 5.0], minimum_clearance=[0.25, 0.5]),
        "goal": make(finished_at=[None, None], minimum_clearance=[None, None]),
    }
    return Comparison(runs, {"two-layer": short, "goal": short})


def summarise(runs: tuple[ExplorationMetrics, ...]) -> dict[str, Any]:
    return Comparison({"it": runs}, {}).summaries()["it"]


def to_90(seconds: float | None) -> dict[str, float | None]:
    return {"50": 0.1, "90": seconds, "95": None, "99": None}


def watched(mean: float | None, worst: float | None, *, is_patrol: bool = True):
    metrics = WatchMetrics(mean_idleness=mean, worst_idleness=worst, is_patrol=is_patrol)
    return {"watch": metrics}


def sought(seen: int, number: int) -> dict[str, TargetMetrics]:
    return {"targets": TargetMetrics(number=number, seen=seen, last_at=None, how="seen")}


def timed(milliseconds: float) -> Compute:
    return Compute(milliseconds, None, None, None, None, None)


def tree(path: Path) -> list[str]:
    return sorted(str(each.relative_to(path)) for each in path.rglob("*"))


def fail(*_: object, **__: object) -> None:
    raise RuntimeError("in the middle")


@pytest.mark.parametrize(("times", "expected", "text"), QUARTILES)
def test_quartiles_count_a_run_that_does_not_end_as_the_last_one(
    make: Make, times: list[float | None], expected: tuple[float, ...], text: str
) -> None:
    runs = make(
        finished_at=times,
        is_finished=[each is not None for each in times],
        time_to=[to_90(each) for each in times],
    )
    found = summarise(runs)
    assert found["finished_at"] == found["time_to_90"] == expected
    assert found["num_finished"] == (len(times) - times.count(None), len(times))
    comparison = Comparison({"it": runs}, {})
    row = dict(zip(*comparison.rows(), strict=True))
    assert row["after [s]"] == row["90 % after [s]"] == text
    assert row["finished"] == "{} of {}".format(*found["num_finished"])
    plain = comparison.as_dict()["summaries"]["it"]
    assert plain["finished_at"] == [None if each == LATE else each for each in expected]


def test_to_fail_instead_of_ending_never_looks_faster(make: Make) -> None:
    rng = np.random.default_rng(0)
    for _ in range(60):
        times: list[float | None] = rng.uniform(1.0, 9.0, rng.integers(1, 9)).tolist()
        before = (0.0, 0.0, 0.0)
        for failed in rng.permutation(len(times)).tolist():
            found = summarise(make(finished_at=times))["finished_at"]
            assert all(a <= b for a, b in zip(before, found, strict=True))
            assert list(found) == sorted(found)
            # A quartile is finite only if that share of the runs ended.
            ended = sum(each is not None for each in times)
            for share, value in zip((0.25, 0.5, 0.75), found, strict=True):
                assert value == LATE or ended >= share * len(times)
            times[failed], before = None, found


def test_every_number_has_its_own_column(make: Make) -> None:
    runs = make(
        is_finished=[True, False, True],
        finished_at=[11.0, None, 10.0],
        time_to=[to_90(8.5), to_90(9.5), to_90(7.5)],
        path_length=[21.0, 23.0, 22.0],
        information_per_metre=[31.0, 33.0, 32.0],
        final_unknown=[0.41, 0.43, 0.42],
        coverage=[0.51, 0.53, 0.52],
        collisions=[1, 0, 2],
        minimum_clearance=[0.5, None, 0.25],
        command_jerk=[61.0, 69.0, 65.0],
        fault_steps=[0, 5, 7],
        compute=[timed(5.0), timed(7.0), timed(6.0)],
    )
    found = summarise(runs)
    assert found["num_finished"] == (2, 3)
    assert found["coverage"] == pytest.approx((0.515, 0.52, 0.525))
    assert (found["collisions"], found["minimum_clearance"], found["fault_steps"]) == (3, 0.25, 12)
    header, row = Comparison({"it": runs}, {}).rows()
    assert dict(zip(header, row, strict=True)) == {
        "": "it",
        "finished": "2 of 3",
        "after [s]": "11.0 [11.0, -]",
        "90 % after [s]": "8.5 [8.0, 9.0]",
        "coverage [%]": "52.0 [51.5, 52.5]",
        "path [m]": "22.0 [21.5, 22.5]",
        "nat/m": "32.0 [31.5, 32.5]",
        "unknown [%]": "42.0 [41.5, 42.5]",
        "collisions": "3",
        "faults [steps]": "12",
        "clearance [m]": "0.25",
        "jerk [1/s²]": "65 [63, 67]",
        "step [ms]": "6.0 [5.5, 6.5]",
    }


def test_columns_for_missions_appear_where_any_run_has_them(make: Make) -> None:
    added = ("targets seen", "idle mean [s]", "idle worst [s]", "untraversable [steps]")
    plain = Comparison({"it": make(collisions=[0, 1])}, {})
    assert not set(added) & set(plain.rows()[0])
    searched = make(
        parts=[
            watched(7.5, 20.0) | sought(4, 5),
            watched(8.5, 20.0) | sought(3, 5),
            watched(9.5, 20.0) | sought(5, 5),
        ],
        untraversable_steps=[0, 2, 1],
    )
    same = make(parts=[watched(None, None) | sought(4, 5)])
    comparison = Comparison({"a": searched, "b": same}, {})
    header, *rows = comparison.rows()
    a, b = (dict(zip(header, row, strict=True)) for row in rows)
    assert [a[name] for name in added] == ["4.0 [3.5, 4.5]", "8.5 [8.0, 9.0]", "20.0", "3"]
    assert [b[name] for name in added] == ["4.0", "-", "-", "0"]
    plain_values = comparison.as_dict()["summaries"]
    assert plain_values["a"]["targets.seen"] == [3.5, 4.0, 4.5]
    assert plain_values["a"]["targets.number"] == 5
    assert plain_values["a"]["untraversable_steps"] == 3
    assert plain_values["b"]["watch.mean_idleness"] == [None, None, None]
    json.dumps(comparison.as_dict(), allow_nan=False)


def test_steps_that_were_not_timed_have_no_time(make: Make) -> None:
    (metrics,) = make(collisions=[0])
    untimed = dataclasses.replace(metrics.compute, step_ms_p50=None)
    header, row = Comparison({"it": make(compute=[untimed])}, {}).rows()
    assert dict(zip(header, row, strict=True))["step [ms]"] == "-"


def test_a_run_without_a_target_coverage_has_curves(
    vehicle: ExplorationRecording, tmp_path: Path
) -> None:
    metrics = compute_metrics(vehicle)
    Comparison({"it": (metrics, metrics)}, {"it": vehicle}).save(tmp_path / "it")
    assert tree(tmp_path / "it") == ["curves.png", "it.gif", "metrics.json", "table.md"]
    assert "| 3.0 " in (tmp_path / "it" / "table.md").read_text()


def test_nothing_near_has_no_clearance(make: Make) -> None:
    comparison = Comparison({"it": make(minimum_clearance=[None, None])}, {})
    assert comparison.summaries()["it"]["minimum_clearance"] == math.inf
    assert dict(zip(*comparison.rows(), strict=True))["clearance [m]"] == "-"
    assert comparison.as_dict()["summaries"]["it"]["minimum_clearance"] is None


def test_to_stand_still_is_not_worth_more_for_each_metre(make: Make) -> None:
    moved = summarise(make(information_per_metre=[1.0, 2.0, 3.0]))
    stood = summarise(make(information_per_metre=[1.0, 2.0, 3.0, None, None]))
    assert stood["information_per_metre"][1] <= moved["information_per_metre"][1]
    assert stood["information_per_metre"][2] <= moved["information_per_metre"][2]


def test_the_table_is_markdown(comparison: Comparison) -> None:
    rows = comparison.rows()
    assert [row[0] for row in rows] == ["", "two-layer", "goal"]
    lines = str(comparison).splitlines()
    assert len({len(line) for line in lines}) == 1
    cells = [[cell.strip() for cell in line[1:-1].split("|")] for line in lines]
    assert cells[:1] + cells[2:] == [list(row) for row in rows]
    assert all(set(cell) == {"-"} for cell in cells[1] if cell)
    # The rule is as wide as the column, below a header that is empty too.
    assert [len(cell) for cell in cells[1]] == [
        max(len(row[column]) for row in rows) for column in range(len(rows[0]))
    ]


def test_a_controller_without_a_run_is_left_out(make: Make) -> None:
    comparison = Comparison({"a": make(collisions=[1]), "b": ()}, {}, is_interrupted=True)
    assert [row[0] for row in comparison.rows()] == ["", "a"]
    plain = comparison.as_dict()
    assert list(plain["summaries"]) == ["a"]
    assert (len(plain["runs"]["a"]), plain["runs"]["b"]) == (1, [])
    assert plain["is_interrupted"]
    (line,) = curves_figure(comparison.runs).axes[0].lines
    assert line.get_label() == "a"


def test_the_dictionary_holds_every_metric_of_every_run(comparison: Comparison) -> None:
    plain = comparison.as_dict()
    assert not plain["is_interrupted"]
    for name, metrics in comparison.runs.items():
        assert plain["runs"][name] == [each.as_dict() for each in metrics]
        names = {column.name for column in metrics[0].columns}
        assert set(plain["summaries"][name]) == names | {"num_runs"}
        assert plain["summaries"][name]["num_runs"] == len(metrics)


def curve(time: list[float], **columns: list[float | None]) -> dict[str, list[float | None]]:
    blank: list[float | None] = [0.0] * len(time)
    return {"time": [*time], "coverage": blank, "unknown": blank, **columns}


def drawn(axes: Any, number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Read time, median and both edges of the band of a controller back from the picture."""
    time, median = axes.lines[number].get_data()
    (path,) = axes.collections[number].get_paths()
    edges = [path.vertices[path.vertices[:, 0] == at, 1] for at in time]
    low, high = (np.array([pick(each) for each in edges]) for pick in (np.min, np.max))
    return time, median, low, high


def test_curves_are_medians_with_bands_and_ended_runs_keep_their_last_value(make: Make) -> None:
    curves = [
        curve([0.0, 1.0, 2.0], coverage=[0.0, 0.25, 0.5], unknown=[0.75, 0.5, 0.25]),
        curve([0.0, 4.0], coverage=[0.0, 1.0], unknown=[1.0, 0.0]),
        curve([0.0, 2.0, 3.0], coverage=[0.25, 0.5, 0.75], unknown=[0.5, 0.5, 0.125]),
    ]
    runs = {
        "three": make(duration=[2.0, 4.0, 3.0], coverage_curve=curves),
        "one": make(duration=[1.0], coverage_curve=[curve([0.0, 1.0], coverage=[0.5, 0.75])]),
    }
    figure = curves_figure(runs)
    for axes, name in zip(figure.axes, ("coverage", "unknown"), strict=True):
        time, median, low, high = drawn(axes, 0)
        assert (time[0], time[-1]) == axes.get_xlim() == (0.0, 4.0)
        assert np.diff(time).max() < 0.02
        lines = []
        for each in curves:
            end, last = each["time"][-1], each[name][-1]
            inside = np.interp(np.minimum(time, end), each["time"], each[name])
            lines.append(np.where(time >= end, last, inside))
        expected = 100.0 * np.quantile(lines, [0.25, 0.5, 0.75], axis=0)
        np.testing.assert_allclose([low, median, high], expected, atol=1e-9)
    # By hand: at the end 50, 75 and 100 % are covered, 0, 12.5 and 25 % unknown.
    ends = [[float(each[-1]) for each in drawn(axes, 0)[1:]] for axes in figure.axes]
    assert ends == [[75.0, 62.5, 87.5], [12.5, 6.25, 18.75]]
    time, *alone = drawn(figure.axes[0], 1)
    for each in alone:
        np.testing.assert_allclose(each, np.minimum(50.0 + 25.0 * time, 75.0))


def test_curves_skip_points_without_a_value(make: Make) -> None:
    holes = curve([0.0, 1.0, 2.0], coverage=[0.0, None, 0.5])
    figure = curves_figure({"it": make(duration=[2.0], coverage_curve=[holes])})
    time, median, *_ = drawn(figure.axes[0], 0)
    np.testing.assert_allclose(median, 25.0 * time)


def test_curves_tell_the_controllers_apart(make: Make) -> None:
    names = [f"controller {number}" for number in range(5)]
    figure = curves_figure({name: make(collisions=[0, 0, 0]) for name in names})
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == names
    assert "seeds: 3" in figure.get_suptitle()
    for axes in figure.axes:
        colours = [line.get_color() for line in axes.lines]
        assert len(set(colours)) == len(names)
        for line, band in zip(axes.lines, axes.collections, strict=True):
            (fill,) = band.get_facecolor()
            expected = [int(line.get_color()[at : at + 2], 16) / 255 for at in (1, 3, 5)]
            np.testing.assert_allclose(fill[:3], expected)
            assert fill[3] < 0.5
    assert [axes.get_xlabel() for axes in figure.axes] == ["time [s]"] * 2
    assert "coverage" in figure.axes[0].get_ylabel()
    assert "unknown" in figure.axes[1].get_ylabel()


@pytest.mark.parametrize("has_runs", [False, True])
def test_curves_of_nothing_can_be_drawn(no_step: ExplorationRecording, has_runs: bool) -> None:
    runs = {"it": (compute_metrics(no_step),)} if has_runs else {}
    figure = curves_figure(runs)
    figure.canvas.draw()
    assert len(figure.axes[0].lines) == len(runs)


def test_a_folder_holds_everything(comparison: Comparison, tmp_path: Path) -> None:
    settings = {"map": "zones", "lidar": {"num_beams": 24, "max_range": 4.0}, "goal": None}
    shares: list[float] = []
    comparison.save(tmp_path / "it", settings=settings, on_progress=shares.append)
    names = ["curves.png", "goal.gif", "metrics.json", "settings.yaml", "table.md", "two-layer.gif"]
    assert tree(tmp_path / "it") == names
    assert shares == sorted(shares)
    assert shares[-1] == 1.0

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    text = (tmp_path / "it" / "metrics.json").read_text()
    found = json.loads(text, parse_constant=refuse)
    assert found == comparison.as_dict()
    assert found["summaries"]["two-layer"]["finished_at"] == [3.5, 4.0, 4.5]
    assert found["summaries"]["goal"]["finished_at"] == [None, None, None]
    assert (tmp_path / "it" / "table.md").read_text() == f"{comparison}\n"
    written = yaml.safe_load((tmp_path / "it" / "settings.yaml").read_text())
    assert written == settings
    assert list(written) == list(settings)
    with Image.open(tmp_path / "it" / "curves.png") as image:
        image.load()
        assert image.format == "PNG"
        assert min(image.size) > 300
    for name in comparison.runs:
        with Image.open(tmp_path / "it" / f"{name}.gif") as image:
            assert (image.format, image.n_frames) == ("GIF", 2)


def test_animation_and_settings_may_be_left_out(comparison: Comparison, tmp_path: Path) -> None:
    comparison.save(tmp_path / "it", animation=False)
    assert tree(tmp_path / "it") == ["curves.png", "metrics.json", "table.md"]


def test_without_a_single_run_it_can_be_saved(tmp_path: Path) -> None:
    Comparison({"a": (), "b": ()}, {}, is_interrupted=True).save(tmp_path / "it")
    assert tree(tmp_path / "it") == ["curves.png", "metrics.json", "table.md"]
    assert json.loads((tmp_path / "it" / "metrics.json").read_text())["is_interrupted"]
    assert len((tmp_path / "it" / "table.md").read_text().splitlines()) == 2


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("name", ["curves_figure", "write_animation"])
def test_an_exception_leaves_what_was_there(
    comparison: Comparison,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    overwrite: bool,
) -> None:
    place = tmp_path / "a" / "it"
    if overwrite:
        comparison.save(place, animation=False)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    monkeypatch.setattr(module if name == "curves_figure" else ExplorationRecording, name, fail)
    with pytest.raises(RuntimeError, match="in the middle"):
        comparison.save(place, overwrite=overwrite)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert overwrite or tree(tmp_path) == []


def test_a_disk_that_fills_is_one_line_and_leaves_nothing(
    comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(ExplorationRecording, "write_animation", full)
    with pytest.raises(ValueError, match=r"it' cannot be written: No space left") as caught:
        comparison.save(tmp_path / "it")
    assert "\n" not in str(caught.value)
    assert tree(tmp_path) == []


def test_ctrl_c_while_drawing_leaves_out_animations_only(
    comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(ExplorationRecording, "write_animation", interrupt)
    # Caught here as well, so that pytest itself does not take it for a user's.
    with contextlib.suppress(KeyboardInterrupt):
        comparison.save(tmp_path / "it")
    assert tree(tmp_path) == ["it", "it/curves.png", "it/metrics.json", "it/table.md"]


def test_overwriting_replaces_all_of_a_former_comparison(
    comparison: Comparison, tmp_path: Path
) -> None:
    comparison.save(tmp_path / "it", settings={"a": 1}, animation=False)
    with pytest.raises(ValueError, match="former run"):
        comparison.save(tmp_path / "it", animation=False)
    assert "it/settings.yaml" in tree(tmp_path)
    dataclasses.replace(comparison, is_interrupted=True).save(
        tmp_path / "it", animation=False, overwrite=True
    )
    assert tree(tmp_path) == ["it", "it/curves.png", "it/metrics.json", "it/table.md"]
    assert json.loads((tmp_path / "it" / "metrics.json").read_text())["is_interrupted"]


def test_settings_that_are_not_plain_are_refused_before_anything_is_written(
    comparison: Comparison, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match="settings cannot be written as YAML"):
        comparison.save(tmp_path / "it", settings={"a": np.ones(2)})
    assert tree(tmp_path) == []


def test_an_animation_stays_in_the_folder_whatever_its_name(
    comparison: Comparison, tmp_path: Path
) -> None:
    runs, recordings = (
        {"../goal": each["goal"]} for each in (comparison.runs, comparison.recordings)
    )
    try:
        Comparison(runs, recordings).save(tmp_path / "it")
    except ValueError:
        assert tree(tmp_path) == []
    assert not (tmp_path / "goal.gif").exists()


def test_curves_and_films_of_a_known_map_show_no_coverage(make: Make) -> None:
    times: dict[str, list[float | None]] = {
        "time": [0.0, 1.0, 2.0],
        "coverage": [1.0, 1.0, 1.0],
        "unknown": [0.0, 0.0, 0.0],
        "idleness": [0.0, 1.0, 2.0],
        "targets": [0.0, 0.0, 1.0],
    }

    def labels(**changes: object) -> list[str]:
        runs = make(duration=[2.0], coverage_curve=[times], **changes)
        return [axes.get_ylabel() for axes in curves_figure({"it": runs}).axes]

    known = {"initial_unknown": [0.01]}
    assert labels(**known, parts=[watched(1.5, 2.0)]) == ["mean idleness [s]"]
    searching = watched(1.5, 2.0, is_patrol=False)
    assert labels(**known, parts=[searching | sought(1, 2)]) == ["targets found"]
    unknown = {"initial_unknown": [0.02]}
    both = ["coverage of reachable cells [%]", "unknown reachable cells [%]"]
    assert labels(**unknown) == both
    assert labels(**unknown, parts=[sought(1, 2)]) == [*both, "targets found"]
    # One scan may see all of a small room that nobody knew.
    at_once = {str(level): 0.0 for level in (50, 90, 95, 99)}
    assert labels(time_to=[at_once]) == both


@pytest.mark.parametrize("most", [1.0, 2.0, 7.0, 30.0])
def test_ticks_of_found_targets_are_whole_numbers(make: Make, most: float) -> None:
    times: dict[str, list[float | None]] = {
        "time": [0.0, 1.0, 2.0],
        "coverage": [0.0, 0.5, 1.0],
        "unknown": [1.0, 0.5, 0.0],
        "targets": [0.0, 0.0, most],
    }
    runs = make(duration=[2.0], coverage_curve=[times], parts=[sought(0, int(most))])
    figure = curves_figure({"it": runs})
    ticks = figure.axes[-1].get_yticks()
    assert figure.axes[-1].get_ylabel() == "targets found"
    assert len(ticks) >= 2
    np.testing.assert_array_equal(ticks, np.round(ticks))


def test_films_have_the_name_of_their_variant(
    comparison: Comparison, tmp_path: Path, written: list[tuple[str, object]]
) -> None:
    comparison.save(tmp_path / "it", film=FilmOptions(scale=0.5), figures=["svg"])
    assert set(comparison.recordings) <= {words for words, _ in written}
    assert "it/curves.svg" in tree(tmp_path)
    assert "it/curves.png" not in tree(tmp_path)
