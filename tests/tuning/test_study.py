import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.study.tuning import (
    FunctionEpisodes,
    Measure,
    Objective,
    Parameter,
    Search,
    Space,
    VectorEpisodes,
    open_study,
    tune,
)
from jaxplore.study.tuning.pictures import importances

pytestmark = pytest.mark.long

START = {"a": -0.9, "b": 50.0}
SPACE = Space((Parameter("a", -1.0, 1.0), Parameter("b", 0.1, 100.0, is_log=True)))


def bowl(values, key):
    """Least, 0, at a = 0.3 and b = 2; each seed adds its own number, the same to all."""
    a, b = values["a"], jnp.log(values["b"] / 2.0)
    return {"cost": (a - 0.3) ** 2 + 0.3 * b**2, "a": a, "nothing": jnp.full((), jnp.nan)}


@pytest.fixture(scope="module")
def episodes() -> VectorEpisodes:
    return VectorEpisodes(bowl, START)


def search(optimizer: str = "tpe", **options) -> Search:
    objective = options.pop("objective", "cost")
    objectives = tuple(map(Objective.parse, objective.split(";")))
    return Search(SPACE, objectives, options.pop("seeds", (0, 1)), optimizer, **options)


def results(study) -> list[tuple]:
    return [(each.candidate, each.values, each.state) for each in study.trials()]


@pytest.mark.parametrize(
    ("optimizer", "error"),
    # How near the optimum in the cube, after 160 candidates: a random search gets to 0.05.
    [("tpe", 0.03), ("cma-es", 0.03), ("sep-cma-es", 0.06), ("cr-fm-nes", 0.03), ("snes", 0.08)],
)
def test_the_optimum_of_a_bowl_is_found(episodes, optimizer, error) -> None:
    with open_study(search(optimizer), episodes) as study:
        assert study.run(160)
        best = study.best()
    distance = SPACE.places(best.candidate) - SPACE.places({"a": 0.3, "b": 2.0})
    assert np.linalg.norm(distance) < error
    assert len(results(study)) == 160


@pytest.mark.parametrize("optimizer", ["open-es", "pgpe", "random", "qmc"])
def test_others_get_nearer_than_the_start(episodes, optimizer) -> None:
    with open_study(search(optimizer), episodes) as study:
        study.run(80)
        trials = study.trials()
        assert trials[0].candidate == pytest.approx(START)
        assert study.best().values[0] < 0.2 * trials[0].values[0]
        assert study.best().values[0] == min(each.values[0] for each in trials if each.values)


@pytest.mark.parametrize("optimizer", ["tpe", "cma-es", "cma-me", "nsga-ii"])
def test_taken_up_again_is_as_if_never_interrupted(episodes, optimizer, tmp_path) -> None:
    """Also in the middle of a generation, and from the same seed it is the same at all."""
    measures = (Measure("a", -1.0, 1.0, 5),) if optimizer == "cma-me" else ()
    asked = search(optimizer, population=4, measures=measures, seed=3)
    with open_study(asked, episodes) as study:
        study.run(12)
        whole = results(study)
    for left in (5, 100):

        class Interrupted(VectorEpisodes):
            def run(self, episodes, on_result) -> None:
                def done(episode, told) -> None:
                    nonlocal left
                    if left == 0:
                        raise KeyboardInterrupt
                    left -= 1
                    on_result(episode, told)

                super().run(episodes, done)

        with open_study(asked, Interrupted(bowl, START), tmp_path / "study") as study:
            if study.run(12):
                break
    assert results(study) == whole


KILLED = """
import os, sys
from pathlib import Path
from jaxplore.study.tuning import FunctionEpisodes, Objective, Parameter, Search, Space, open_study

def search(folder, calls=-1):
    def tried(candidate, seed):
        nonlocal calls
        if calls == 0:
            os.kill(os.getpid(), 9)
        calls -= 1
        with (folder / "calls.txt").open("a") as file:
            file.write(f"{candidate['x']!r} {seed}\\n")
        return {"cost": (candidate["x"] - 0.25) ** 2}

    space = Space((Parameter("x", -1.0, 1.0),))
    search = Search(space, (Objective.parse("cost"),), (0, 1), "tpe", population=3, gives_up=True)
    with open_study(search, FunctionEpisodes(tried, {"x": 0.9}), folder / "study") as study:
        study.run(9)
        return [(each.number, each.candidate, each.values, each.state) for each in study.trials()]

if __name__ == "__main__":
    search(Path(sys.argv[1]), 5)
"""


def test_a_killed_search_loses_nothing_and_does_nothing_twice(tmp_path) -> None:
    """SIGKILL after so many episodes; then the same search until it is done."""
    for name in ("whole", "killed"):
        (tmp_path / name).mkdir()
    command = [sys.executable, "-c", KILLED, str(tmp_path / "killed")]
    killed = subprocess.run(command, capture_output=True, text=True, check=False)
    assert killed.returncode == -9, killed.stderr
    assert len((tmp_path / "killed" / "calls.txt").read_text().splitlines()) == 5
    program = {"__name__": "killed"}
    exec(KILLED, program)
    whole, again = (program["search"](tmp_path / name) for name in ("whole", "killed"))
    assert again == whole
    # Each episode ran once; none of those that were done before the kill ran again.
    lines, expected = (
        (tmp_path / name / "calls.txt").read_text().splitlines() for name in ("killed", "whole")
    )
    assert sorted(lines) == sorted(expected)
    assert len(set(lines)) == len(lines)


def test_candidates_that_fail_are_kept_and_the_search_goes_on() -> None:
    def tried(candidate, seed):
        if candidate["x"] < 0.0:
            raise RuntimeError("left of zero")
        return {"cost": candidate["x"] if candidate["x"] < 0.8 else None}

    found = tune(
        FunctionEpisodes(tried, {"x": 0.5}), ["x=-1:1"], "cost", budget=30, optimizer="cma-es"
    )
    failed = [each for each in found.trials if each.state == "failed"]
    assert {each.error for each in failed} == {
        "RuntimeError: left of zero",
        "objective cost is not a number",
    }
    assert all(each.values == () for each in failed)
    assert 0.0 <= found.chosen.candidate["x"] < 0.1


def test_an_objective_without_a_value_for_anybody_is_an_error(episodes) -> None:
    with (
        open_study(search(objective="nothing"), episodes) as study,
        pytest.raises(ValueError, match=r"objective nothing is not a number for any of 8 cand"),
    ):
        study.run(100)
    with (
        open_study(search(objective="costs"), episodes) as study,
        pytest.raises(ValueError, match=r"metric costs is not known; accepted: such as cost"),
    ):
        study.run(100)


def test_what_looks_worse_than_most_is_given_up() -> None:
    """By the difference to the start: the second episode is harder for everybody."""
    calls: list[tuple[float, int]] = []

    def tried(candidate, seed):
        calls.append((candidate["x"], seed))
        return {"cost": abs(candidate["x"]) + 100.0 * seed}

    asked = Search(
        Space((Parameter("x", -1.0, 1.0),)), (Objective.parse("cost"),), (0, 1, 2), "random"
    )
    with open_study(asked, FunctionEpisodes(tried, {"x": 0.5})) as study:
        study.run(40)
        trials = study.trials()
    given_up = [each for each in trials if each.state == "given up"]
    assert 8 <= len(given_up) <= 32
    assert all(each.number >= 8 and len(each.episodes) < 3 for each in given_up)
    assert len(calls) == sum(len(each.episodes) for each in trials) < 3 * 40
    # Who was best was tried out to the end.
    assert study.best().values[0] == pytest.approx(
        100.0 + min(abs(each.candidate["x"]) for each in trials)
    )
    others = [abs(each.candidate["x"]) for each in trials if each.state == "done"]
    assert np.mean([abs(each.candidate["x"]) for each in given_up]) > np.mean(others)


def test_an_episode_is_given_up_after_twice_the_best_duration() -> None:
    limits = []

    def run(episodes, on_result):
        from jaxplore.study.tuning import Result

        for episode in episodes:
            limits.append(episode.time_limit)
            needed = 10.0 + 100.0 * abs(episode.candidate["x"])
            limit = 500.0 if episode.time_limit is None else episode.time_limit
            done = needed <= limit
            metrics = {"duration": min(needed, limit), "is_finished": float(done)}
            metrics |= {"finished_at": needed, "cost": needed}
            on_result(episode, Result(metrics))

    simulated = FunctionEpisodes(lambda *_: {}, {"x": 0.9})
    simulated.run = run
    space = Space((Parameter("x", -1.0, 1.0),))
    # Who takes long may still be good where time is not what counts.
    for objective, gives_up in (("cost", True), ("finished_at", False)):
        asked = Search(space, (Objective.parse(objective),), (0,), "random", gives_up=gives_up)
        with open_study(asked, simulated) as study:
            study.run(16)
        assert set(limits) == {None}
    limits.clear()
    asked = Search(space, (Objective.parse("finished_at"),), (0,), "random")
    with open_study(asked, simulated) as study:
        study.run(16)
        trials = study.trials()
    assert limits[:8] == [None] * 8
    fastest = min(each.values[0] for each in trials[:8])
    assert limits[8:] == pytest.approx([2.0 * fastest] * 8)
    for each in trials[8:]:
        assert (each.state == "given up") == (each.values[0] > 2.0 * fastest)
    assert any(each.state == "given up" for each in trials[8:])


def test_a_file_that_fails_during_the_search_is_one_line(episodes, tmp_path) -> None:
    def run() -> None:
        with open_study(search(), episodes, tmp_path) as study:
            (tmp_path / "study.jsonl").write_bytes(b"{" + bytes(5000))
            study.run(2)

    with pytest.raises(ValueError, match=r"study '.*study.jsonl' cannot be written: another .*"):
        run()
    assert [each.name for each in tmp_path.iterdir()] == ["study.jsonl"]


def test_a_study_of_something_else_is_refused(episodes, tmp_path) -> None:
    folder = tmp_path / "study"
    with open_study(search(), episodes, folder) as study:
        study.run(2)
    for other, told in (
        (search(seeds=(0, 2)), r"was made with search.seeds \[0, 1\], asked is \[0, 2\]"),
        (search("random"), r"search.optimizer 'tpe', asked is 'random'; accepted: the same"),
        (search(objective="a"), r"search.objectives \['cost'\]"),
    ):
        with pytest.raises(ValueError, match=told), open_study(other, episodes, folder):
            pass
    elsewhere = VectorEpisodes(bowl, START, "another")
    with (
        pytest.raises(ValueError, match=r"episodes.function 'function', asked is 'another'"),
        open_study(search(), elsewhere, folder),
    ):
        pass
    with open_study(search(), episodes, folder) as study:
        study.run(4)
        assert len(study.trials()) == 4
        with (
            pytest.raises(ValueError, match=r"is in use by another process"),
            open_study(search(), episodes, folder),
        ):
            pass
    (folder / "study.jsonl").write_bytes(b"no database")
    with (
        pytest.raises(ValueError, match=r"study\.jsonl' cannot be read: \w+; accepted: a study of"),
        open_study(search(), episodes, folder),
    ):
        pass


def test_a_folder_that_cannot_be_written_is_named(episodes, tmp_path) -> None:
    (tmp_path / "file").touch()
    with (
        pytest.raises(ValueError, match=r"study folder '.*file/study' cannot be written"),
        open_study(search(), episodes, tmp_path / "file" / "study"),
    ):
        pass


def test_several_objectives_leave_a_front(episodes) -> None:
    """Of (a - 0.3)^2 and -a: nobody of the front is beaten, and everybody else is."""
    asked = search("nsga-ii", objective="cost;-a")
    with open_study(asked, episodes) as study:
        study.run(80)
        front, trials = study.front(), study.trials()
        chosen = study.best()
    values = np.array([each.values for each in trials])
    for each in trials:
        other = np.array(each.values)
        beaten = ((values <= other).all(axis=1) & (values < other).any(axis=1)).any()
        assert beaten == (each.number not in {one.number for one in front})
    assert chosen.number in {each.number for each in front}
    with pytest.raises(ValueError, match=r"optimizer is cma-es with 2 objectives; accepted for"):
        search("cma-es", objective="cost;a")


def test_measures_are_for_quality_diversity_and_have_cells() -> None:
    with pytest.raises(
        ValueError, match=r"measures are \[\] for cma-me; accepted: some for cma-me"
    ):
        search("cma-me")
    with pytest.raises(ValueError, match=r"measure a has 1 cells from 0 to 1; accepted: at least"):
        Measure("a", 0.0, 1.0, 1)


def test_the_lucky_one_is_not_chosen() -> None:
    """x = 0.9 is best with the seeds of the search only, x = 0.1 with others, too."""

    def tried(candidate, seed):
        luck = -1.0 if candidate["x"] == 0.9 and seed < 2 else 0.0
        return {"cost": candidate["x"] + luck}

    found = tune(
        FunctionEpisodes(tried, {"x": 0.5}),
        ["x=0.1,0.5,0.9"],
        "cost",
        budget=32,
        seeds=2,
        optimizer="random",
        gives_up=False,
    )
    least = min((each for each in found.trials), key=lambda each: each.values[0])
    assert least.candidate["x"] == 0.9
    assert found.chosen.candidate["x"] == 0.1


def test_what_matters_is_said_to_matter(episodes) -> None:
    def tried(values, key):
        return {"cost": 10.0 * values["a"] ** 2 + 1e-3 * jnp.log(values["b"]) ** 2}

    with open_study(search("random", gives_up=False), VectorEpisodes(tried, START)) as study:
        study.run(80)
        shares = importances(study)
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["a"] > 0.8


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"optimizer": "adam"}, r"optimizer is 'adam'; accepted: tpe, "),
        ({"seeds": (1, 1)}, r"seeds are \[1, 1\]; accepted: different"),
        ({"population": 0}, r"population is 0; accepted: a whole number >= 1"),
        (
            {"optimizer": "cma-es", "population": 5},
            r"population is 5; accepted for cma-es: an even",
        ),
    ],
)
def test_bad_searches_are_named(options, message) -> None:
    with pytest.raises(ValueError, match=message):
        search(**options)


def test_the_function_is_traced_once_for_all_generations() -> None:
    traces = 0

    def tried(values, key):
        nonlocal traces
        traces += 1
        return {"cost": values["a"] ** 2}

    tune(VectorEpisodes(tried, START), ["a=-1:1"], "cost", budget=40, optimizer="cma-es")
    assert traces == 1


def test_a_call_gives_the_verdict_and_writes_the_folder(episodes, tmp_path) -> None:
    searched = ["a=-1:1", "b=0.1:100:log"]
    found = tune(
        episodes, searched, "cost", budget=40, seeds=2, unseen=4, folder=tmp_path, title="Bowl"
    )
    assert found.is_complete
    assert found.verdict == (
        "The chosen settings are better than the current ones, also on unseen seeds."
    )
    # Seeds 0 and 1 were searched with, 2 to 7 chose.
    assert list(found.before) == list(found.after) == [("function", seed) for seed in range(8, 12)]
    (change, *_) = found.changes
    assert (change.name, change.before) == (
        "cost",
        pytest.approx(found.before["function", 8]["cost"]),
    )
    assert change.is_significant
    assert found.current == START
    assert [row[0] for row in found.rows()[:4]] == ["", "a", "b", "cost"]
    assert {path.name for path in found.files} >= {"record.yaml", "report.html", "unseen.csv"}
    assert found.verdict in (tmp_path / "report.html").read_text()
    # Where it begins cannot be beaten.
    best = VectorEpisodes(bowl, {"a": 0.3, "b": 2.0})
    assert tune(best, searched, "cost", budget=16).verdict == (
        "No candidate beat the current settings."
    )


def test_an_objective_must_be_given_or_known(episodes) -> None:
    with pytest.raises(ValueError, match="objective is missing; accepted: a sum of metrics"):
        tune(episodes, ["a=-1:1"], budget=8)
    with pytest.raises(ValueError, match="unseen is 0; accepted: a whole number >= 1"):
        tune(episodes, ["a=-1:1"], "cost", budget=8, unseen=0)
