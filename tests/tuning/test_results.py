"""What a search leaves behind: its tables and pictures."""

import csv

import numpy as np
import pytest
from PIL import Image

from jaxplore.study.tuning import (
    FunctionEpisodes,
    Measure,
    Objective,
    Parameter,
    Search,
    Space,
    open_study,
)
from jaxplore.study.tuning.pictures import figures
from jaxplore.study.tuning.report import write_results
from jaxplore.study.tuning.tune import compare_on_unseen

START = {"a": 0.8, "b": 1.0}
SPACE = Space((Parameter("a", 0.0, 1.0), Parameter("b", 0.1, 10.0, is_log=True)))


def valley(candidate, seed) -> dict[str, float]:
    a, b = candidate["a"], np.log10(candidate["b"])
    return {"cost": (a - 0.3) ** 2 + b**2 + 0.01 * seed, "speed": a, "room": 1.0 + b}


def search(optimizer: str, objectives: str, **options) -> Search:
    parsed = tuple(map(Objective.parse, objectives.split(";")))
    return Search(SPACE, parsed, (0, 1), optimizer, gives_up=False, **options)


def rows(path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def written(study, folder) -> set[str]:
    """Write what a search found, and return the names of the files."""
    found = compare_on_unseen(study, study.best(), range(5, 8))
    paths = write_results(study, found, folder, title="Valley")
    for path in paths:
        if path.suffix == ".png":
            with Image.open(path) as picture:
                assert min(picture.size) > 300
                picture.verify()
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("<img") == sum(path.suffix == ".png" for path in paths)
    return {path.name for path in paths}


@pytest.mark.parametrize("both", [False, True])
def test_quality_diversity_keeps_the_best_of_each_cell(tmp_path, both) -> None:
    measures = (Measure("speed", 0.0, 1.0, 4), Measure("room", 0.0, 2.0, 3))[: 1 + both]
    asked = search("cma-me", "cost", measures=measures, population=10)
    with open_study(asked, FunctionEpisodes(valley, START), tmp_path) as study:
        study.run(60)
        assert written(study, tmp_path) >= {"archive.csv", "archive.png", "slices.png"}
        (axes, *_) = figures(study, study.best())["archive"].axes
        trials = study.trials()
    best = np.full((4, 3) if both else (4,), np.inf)
    for each in trials:
        told = valley(each.candidate, 0)
        at = (min(int(4 * told["speed"]), 3), min(int(1.5 * told["room"]), 2))[: 1 + both]
        best[at] = min(best[at], each.values[0])
    best[np.isinf(best)] = np.nan
    assert np.isfinite(best).sum() > 3
    if both:
        drawn = axes.collections[0].get_array()
        np.testing.assert_allclose(np.ma.filled(drawn, np.nan).reshape(3, 4).T, best)
    else:
        np.testing.assert_allclose(axes.patches[0].get_data().values, best)
    table = rows(tmp_path / "archive.csv")
    costs = sorted(float(row["cost"]) for row in table)
    np.testing.assert_allclose(costs, np.sort(best[np.isfinite(best)]))


def test_compromises_are_drawn_and_written(tmp_path) -> None:
    asked = search("nsga-ii", "cost;-speed")
    with open_study(asked, FunctionEpisodes(valley, START), tmp_path) as study:
        study.run(24)
        names = written(study, tmp_path)
        front = study.front()
    assert names >= {"front.csv", "front.png", "slices.png", "slices-2.png"}
    numbers = {int(row["number"]) for row in rows(tmp_path / "front.csv")}
    assert numbers == {each.number for each in front}
    assert len(numbers) > 1


def test_ticks_of_candidates_and_of_whole_numbers_are_whole(tmp_path) -> None:
    few = Search(
        Space((Parameter("a", 1.0, 3.0, is_whole=True), Parameter("b", 0.0, 1.0))),
        (Objective.parse("cost"),),
        (0,),
        "random",
    )
    with open_study(few, FunctionEpisodes(valley, {"a": 1, "b": 0.5}), tmp_path) as study:
        study.run(3)
        drawn = figures(study, study.best())
    for axes in (drawn["convergence"].axes[0], drawn["slices"].axes[0]):
        ticks = axes.get_xticks()
        assert len(ticks) >= 2
        np.testing.assert_array_equal(ticks, np.round(ticks))


def test_candidates_without_a_value_are_marks_on_the_edge_of_the_convergence(tmp_path) -> None:
    def half(candidate, seed) -> dict[str, float]:
        if candidate["a"] > 0.85:
            raise ValueError("too large")
        return valley(candidate, seed)

    with open_study(search("random", "cost"), FunctionEpisodes(half, START), tmp_path) as study:
        study.run(20)
        trials = study.trials()
        figure = figures(study, study.best())["convergence"]
    (axes,) = figure.axes
    drawn = {each.get_label(): each for each in axes.collections}
    by_state = {
        state: [each for each in trials if each.state == state] for state in ("done", "failed")
    }
    assert by_state["failed"]
    places = np.asarray(drawn["evaluated"].get_offsets())
    expected = [(each.number, each.values[0]) for each in by_state["done"]]
    np.testing.assert_allclose(places, expected)
    low, high = axes.get_ylim()
    assert (low <= places[:, 1]).all()
    assert (places[:, 1] <= high).all()
    marks = np.asarray(drawn["failed"].get_offsets())
    np.testing.assert_array_equal(marks[:, 0], [each.number for each in by_state["failed"]])
    assert (marks[:, 1] == 1.0).all()
    assert "given up early" not in drawn
