import functools
import io
import json
import math
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image, ImageChops

import jaxplore as jx
from jaxplore.report.drawing.film import CAPTION, FilmOptions
from jaxplore.report.following.animation import path_frame_image
from jaxplore.study.runner import Runner
from jaxplore.study.tuning import ControllerEpisodes, Episode, SettingsEpisodes, tune
from jaxplore.study.tuning.before_after import side_by_side
from jaxplore.study.tuning.episodes import make_tasks
from jaxplore.study.tuning.objective import Objective
from jaxplore.study.tuning.result import TuningResult
from jaxplore.study.tuning.significance import change, changes, table, verdict
from jaxplore.study.tuning.trials import Trial
from jaxplore.tasks.registry import build, make_settings

pytestmark = pytest.mark.long

QUICK = {
    "path": "track",
    "time_limit": 0.6,
    "controller": {"num_samples": 16, "horizon": 6, "temperature": 20.0},
}
"""A run along the generated track of 30 steps."""


@pytest.fixture(scope="module")
def path_episodes() -> SettingsEpisodes:
    return SettingsEpisodes({"path": QUICK})


def told(episodes, asked) -> dict:
    found = {}
    episodes.run(asked, lambda episode, result: found.__setitem__(episode, result))
    assert len(found) == len(asked)
    return {(episode.number, episode.seed): result for episode, result in found.items()}


class Asked(Episode):
    """One that can be a key."""

    def __hash__(self) -> int:
        return hash((self.number, self.seed))


def asked(number, candidate, seed=0, **options) -> Asked:
    return Asked(number, candidate, "path", seed, **options)


def test_values_become_settings_and_paths_become_parameters(path_episodes) -> None:
    values = {
        "controller.temperature": 3.0,
        "cost.comfort.weight": 7.0,
        "proposal.physical.noise_std[1]": 0.25,
        "controller.horizon": 9,
    }
    settings = path_episodes.settings("path", values)
    assert settings.controller.temperature == 3.0
    assert settings.controller.horizon == 9
    assert settings.controller.num_samples == 16
    controller = build(settings).controller
    found = jx.get_parameters(controller)
    assert controller.horizon == 9
    assert found["weighting.temperature"] == 3.0
    assert found["cost.comfort.weight"] == 7.0
    assert found["proposal.physical.noise_std"][1] == 0.25
    before = jx.get_parameters(build(make_settings(QUICK)).controller)
    assert found["proposal.physical.noise_std"][0] == before["proposal.physical.noise_std"][0]


def test_names_are_settings_first_and_arrays_stand_for_their_elements(path_episodes) -> None:
    assert path_episodes.start("controller.temperature") == 20.0
    assert path_episodes.start("controller.num_samples") == 16
    assert path_episodes.start("weighting.temperature") == 20.0
    assert path_episodes.elements("physical.noise_std") == (
        "physical.noise_std[0]",
        "physical.noise_std[1]",
    )
    assert path_episodes.elements("controller.temperature") == ("controller.temperature",)
    for name, message in (
        ("controller.temprature", r"temprature is not known; .*controller.temperature"),
        ("physical.noise_std[2]", r"has no element 2; accepted: 0 to 1"),
        ("physical.noise_std[x]", r"is 'physical.noise_std\[x\]'; accepted: a path, or"),
        ("physical.noise_std", r"has 2 elements; accepted: one of them"),
    ):
        with pytest.raises(ValueError, match=message):
            path_episodes.start(name)


def test_one_element_leaves_the_others_as_each_robot_has_them() -> None:
    noisy = {"controller": {"noise_share": 0.4}}
    episodes = SettingsEpisodes({"path": {"path": "track"}, "noisy": {"path": "track", **noisy}})
    path = "proposal.physical.noise_std"
    for entries in ({}, noisy):
        name = "noisy" if entries else "path"
        before = jx.get_parameters(build(make_settings({"path": "track", **entries})).controller)[
            path
        ]
        after = episodes.settings(name, {f"{path}[1]": 0.25}).parameters[path]
        assert after == [before[0], 0.25]


def test_only_settings_that_a_run_reads_can_be_tuned() -> None:
    portfolio = SettingsEpisodes({"warehouse": {"map": "warehouse"}})
    assert portfolio.start("portfolio.temperature") == 0.05
    with pytest.raises(ValueError, match=r"controller.temperature may be any of members.mppi.we"):
        portfolio.start("controller.temperature")
    explorer = SettingsEpisodes({"office": {"map": "office"}})
    assert explorer.start("controller.temperature") == 0.3
    with pytest.raises(ValueError, match=r"parameter portfolio.temperature is not known"):
        explorer.start("portfolio.temperature")


CANDIDATES = (
    {"cost.progress.weight": 500.0, "cost.contouring.weight": 10.0},
    {"cost.progress.weight": 5.0, "cost.contouring.weight": 11.0},
)
SAME = ("duration", "progress", "mean_deviation", "max_speed", "command_jerk")


@pytest.fixture(scope="module")
def alone(path_episodes) -> dict:
    return told(
        path_episodes,
        [asked(i, each, seed) for i, each in enumerate(CANDIDATES) for seed in (0, 1)],
    )


def test_an_episode_is_the_run_of_its_settings(path_episodes, alone) -> None:
    settings = make_settings(path_episodes.entries("path", CANDIDATES[1], 1))
    built = build(settings)
    run = jx.simulate(*built[:3], key=built.key, num_trajectories=0)
    found = alone[1, 1].metrics
    assert found["progress"] == run.metrics.progress
    assert found["command_jerk"] == run.metrics.command_jerk
    # It did not get to the end: as late as what was left of the way.
    left = run.metrics.to_go / (run.metrics.to_go + run.metrics.progress)
    assert run.metrics.finished_at is None
    assert found["finished_at"] == pytest.approx(0.6 * (1.0 + left))
    assert alone[0, 0].metrics["progress"] > alone[1, 0].metrics["progress"]
    assert alone[0, 0].metrics["progress"] != alone[0, 1].metrics["progress"]


@pytest.fixture(scope="module")
def together() -> SettingsEpisodes:
    return SettingsEpisodes({"path": QUICK}, batch=4)


def test_side_by_side_they_are_the_same_but_for_rounding_and_what_is_refused_fails_alone(
    together, alone
) -> None:
    episodes = [asked(i, each, seed) for i, each in enumerate(CANDIDATES) for seed in (0, 1)]
    found = told(together, [*episodes, asked(2, {"controller.horizon": 0})])
    for key, result in alone.items():
        for name in SAME:
            assert found[key].metrics[name] == pytest.approx(result.metrics[name], rel=1e-3), name
    assert found[2, 0].error is not None
    assert "controller.horizon is 0; accepted" in found[2, 0].error


def test_sizes_and_seeds_run_by_themselves() -> None:
    sizes = [asked(i, {"controller.horizon": size}) for i, size in enumerate((6, 5, 6, 6))]
    tasks = make_tasks([*sizes, asked(4, sizes[0].candidate, seed=1)], lambda *_: None, 2, None)
    assert [[each.number for each in task.episodes] for task in tasks] == [[0, 2], [3], [1], [4]]


ON_RAY = """
import json
from jaxplore.study.tuning import SettingsEpisodes, tune
from jaxplore.study.runner import Runner

if __name__ == "__main__":
    quick, searched = json.loads({quick!r}), {searched!r}
    with Runner(2, on_ray=True) as runner:
        episodes = SettingsEpisodes({{"path": quick}}, runner=runner)
        found = tune(episodes, searched, "-progress", budget=6, seeds=2, population=3)
    print(json.dumps([[each.candidate, each.values, each.state] for each in found.trials]))
"""


def test_two_ray_workers_come_to_the_same_as_one_process(path_episodes) -> None:
    searched = ["controller.progress_weight=5:5000:log", "cost.comfort.weight=1:100:log"]
    # In a process of its own: Ray has warnings, and threads that stay.
    program = ON_RAY.format(quick=json.dumps(QUICK), searched=searched)
    command = [sys.executable, "-c", program]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        here = tune(path_episodes, searched, "-progress", budget=6, seeds=2, population=3)
        out, errors = run.communicate()
    assert run.returncode == 0, errors
    there = json.loads(out.splitlines()[-1])
    assert there == [[each.candidate, list(each.values), each.state] for each in here.trials]
    with pytest.raises(ValueError, match=r"batch is 2 with workers; accepted: one of them"):
        SettingsEpisodes({"path": QUICK}, runner=Runner(2), batch=2)


def test_an_episode_is_cut_short_at_its_limit(path_episodes) -> None:
    found = told(path_episodes, [asked(0, CANDIDATES[0], time_limit=0.3)])[0, 0].metrics
    assert found["duration"] == pytest.approx(0.3)
    # Late by the scenario's own limit.
    assert found["finished_at"] > 0.6


def test_a_controller_of_ones_own_is_tuned_by_its_paths() -> None:
    """And a batch comes to the same as one after the other."""
    built = build(make_settings(QUICK))
    searched = ["cost.progress.weight=1:2000:log", "cost.contouring.weight=0.1:100:log"]
    found = [
        tune(
            ControllerEpisodes(
                built.controller, {"track": built.scenario}, time_limit=0.6, batch=batch
            ),
            searched,
            "-progress",
            budget=4,
            seeds=1,
            unseen=1,
            population=4,
            optimizer="random",
            gives_up=False,
        )
        for batch in (1, 4)
    ]
    values = [[each.values[0] for each in one.trials] for one in found]
    np.testing.assert_allclose(values[0], values[1], rtol=1e-3)
    assert found[0].trials[0].candidate["cost.progress.weight"] == 25.0
    with pytest.raises(ValueError, match=r"scenarios is empty; accepted: at least one"):
        ControllerEpisodes(built.controller, {}, time_limit=1.0)


def test_a_change_has_the_interval_of_a_bootstrap() -> None:
    generator = np.random.default_rng(0)
    before = generator.normal(10.0, 1.0, 40)
    after = before - 2.0 + generator.normal(0.0, 0.5, 40)
    found = change("x", before.tolist(), after.tolist())
    difference = after - before
    # The normal approximation of the same.
    half = 1.96 * difference.std(ddof=1) / math.sqrt(40)
    assert found.difference == pytest.approx(difference.mean())
    assert found.low == pytest.approx(difference.mean() - half, abs=0.15 * half)
    assert found.high == pytest.approx(difference.mean() + half, abs=0.15 * half)
    assert found.is_significant
    assert not change("x", before.tolist(), before[::-1].tolist()).is_significant
    single = change("x", [1.0], [3.0])
    assert (single.low, single.difference, single.high) == (2.0, 2.0, 2.0)


def test_a_verdict_needs_an_objective_that_is_certainly_less() -> None:
    objectives = (Objective.parse("cost"), Objective.parse("-speed"))
    less, more = change("cost", [3.0, 4.0], [1.0, 3.0]), change("-speed", [0.0, 0.0], [-1.0, 2.0])
    other = change("time", [3.0, 4.0], [1.0, 3.0])
    assert verdict(0, objectives, [less]) == "No candidate beat the current settings."
    assert verdict(3, objectives, [less, more]).startswith("The chosen settings are better than")
    assert verdict(3, objectives, [more, other]).startswith("The chosen settings are not signif")
    slower = change("-speed", [0.0, 0.1], [1.0, 1.2])
    assert verdict(3, objectives, [less, slower]).endswith("better in cost and worse in -speed.")


def test_evidence_compares_the_same_episodes() -> None:
    one = functools.partial(dict, collisions=0.0)
    before = {("m", 1): one(finished_at=10.0), ("m", 2): one(finished_at=20.0), ("m", 3): {}}
    after = {("m", 1): one(finished_at=8.0), ("m", 2): one(finished_at=14.0), ("m", 3): {}}
    objective = Objective.parse("finished_at + 100*collisions")
    found = changes([objective], before, after)
    assert [each.name for each in found] == [str(objective), "finished_at", "collisions"]
    assert (found[0].before, found[0].after, found[0].difference) == (15.0, 11.0, -4.0)
    rows = table([objective], before, after)
    assert [row["seed"] for row in rows] == [1, 2, 3]
    assert rows[1]["finished_at before"] == 20.0
    assert rows[1][f"{objective} after"] == 14.0
    assert math.isnan(rows[2][f"{objective} before"])


def test_times_that_were_not_reached_are_no_numbers_in_the_tables() -> None:
    late = {"finished_at": 55.0, "late.finished_at": 1.0, "collisions": 0.0}
    before = {("m", 1): {"finished_at": 10.0, "collisions": 0.0}, ("m", 2): late}
    after = {("m", 1): {"finished_at": 8.0, "collisions": 0.0}, ("m", 2): late}
    objective = Objective.parse("finished_at + 100*collisions")
    found = changes([objective], before, after)
    chosen = Trial(1, {"a": 2.0}, (31.5,), "done", {})
    result = TuningResult(
        chosen, {"a": 1.0}, (chosen,), (), True, before, after, tuple(found), "no better"
    )
    rows = {name: texts for name, *texts in result.change_rows()}
    assert rows[str(objective)][:2] == ["32.5 (1 of 2 not reached)", "31.5 (1 of 2 not reached)"]
    assert rows["finished_at"] == ["reached in 1 of 2", "reached in 1 of 2", ""]
    assert rows["collisions"][:2] == ["0", "0"]
    assert [row["finished_at after"] for row in table([objective], before, after)] == [8.0, None]


def test_a_scenario_that_cannot_be_read_is_told_at_once(tmp_path) -> None:
    scenarios = {"path": QUICK, "hall": {**QUICK, "path": str(tmp_path / "hall.csv")}}
    with pytest.raises(ValueError, match=r"hall.csv"):
        SettingsEpisodes(scenarios)


def test_runs_are_beside_each_other_at_the_same_time(path_episodes) -> None:
    ends, pictures = (0.2, 0.6), []
    for end in ends:
        built = build(make_settings({**QUICK, "time_limit": end}))
        run = jx.simulate(built.controller, built.scenario, built.num_steps, key=built.key)
        pictures.append(run.recording)
    named = dict(zip(("before", "after"), pictures, strict=True))
    with Image.open(io.BytesIO(side_by_side(named, FilmOptions()))) as clip:
        sizes = [path_frame_image(each, each.frames[0]).size for each in pictures]
        assert clip.size == (sizes[0][0] + sizes[1][0] + 12, sizes[0][1] + CAPTION)
        # A look of each at the beginning; the shorter one's last; both at their ends.
        times = sorted({frame.time for each in pictures for frame in each.frames})
        assert clip.n_frames == len(times)
        left, right = (0, 0, sizes[0][0], clip.height), (sizes[0][0] + 12, 0, *clip.size)
        clip.seek(times.index(pictures[0].frames[-1].time))
        middle = clip.convert("RGB")
        clip.seek(clip.n_frames - 1)
        last = clip.convert("RGB")
    assert ImageChops.difference(middle.crop(left), last.crop(left)).getbbox() is None
    assert ImageChops.difference(middle.crop(right), last.crop(right)).getbbox() is not None
