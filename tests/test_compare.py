"""`compare` and the command in front of it, with controllers that plan nothing: one small world
and one compiled loop for all tests."""

import contextlib
import dataclasses
import io
import json
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

import jaxplore as jx
from jaxplore import Metrics, compare
from jaxplore.cli import main
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.trajectory import Trajectory
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.loop import _initial_memory, _initial_task, frame_arrays, run_chunk
from jaxplore.study import Comparison
from jaxplore.study import experiments as running
from jaxplore.tasks.exploration import controllers as building
from jaxplore.tasks.registry import build, make_settings

pytestmark = pytest.mark.long

Experiments = dict[str, tuple[Controller, ExplorationScenario, int]]

SEEDS = (3, 1)
# Nothing of the map is known, and so little is seen of it that no run ends early.
WORLD = jx.World(
    size=(4.0, 3.0), resolution=0.2, start=(1.0, 1.5, 0.0), zones=((0.0, 0.0, 4.0, 3.0),)
)
SMALL = ["--samples", "8", "--set", "informative.horizon=4", "--set", "fields.num_directions=4"]
SMALL += ["--beams", "8", "--range", "1", "--time-limit", "0.6"]


@pytest.fixture(scope="module")
def world_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("world") / "room.yaml"
    WORLD.to_yaml(path)
    return path


class Pushed(Controller):
    """Hovers and is pushed about at random: a run shows the key and the strength."""

    hover: jax.Array
    strength: jax.Array

    def init(self):
        return ()

    def step(self, state, observation, belief=None, *, key):
        command = self.hover + self.strength * jax.random.normal(key, self.hover.shape)
        one = jnp.ones(())
        info = Info(command[None], one[None], one[None], one, jnp.array(True))
        return command, state, info

    def inspect(self, state, observation, belief=None, *, key, num_trajectories=50):
        alone = Trajectory(jnp.stack([observation] * 2), self.hover[None], {})
        return SampledPlan(alone, alone, alone.states[None], jnp.ones(1))

    def at_period(self, control_period):
        return self


STRENGTHS = {"two-layer": 0.5, "parallel": 1.0}


def pushed(robot: jx.Quadrotor, architecture: str, **_: object) -> Pushed:
    return Pushed(robot.default_control, jnp.asarray(STRENGTHS[architecture]))


@pytest.fixture(scope="module")
def experiments(world_file: Path) -> Experiments:
    """What the command makes of `SMALL`, for 30 and 40 steps."""
    entries = {
        "map": str(world_file),
        "architecture": "random-walk",
        "lidar": {"num_beams": 8, "max_range": 1.0},
        "fields": {"num_directions": 4},
    }
    _, scenario, _, _ = build(make_settings(entries))
    return {
        name: (pushed(scenario.robot, name), scenario, num_steps)
        for name, num_steps in (("two-layer", 30), ("parallel", 40))
    }


@pytest.fixture(scope="module")
def compared(experiments: Experiments) -> Comparison:
    return compare(experiments, SEEDS)


def timeless(metrics: Metrics) -> dict[str, Any]:
    """Return all but the wall-clock cost."""
    return {name: value for name, value in metrics.as_dict().items() if name != "compute"}


def watch(
    monkeypatch: pytest.MonkeyPatch, act: Callable[[int], None] = lambda _: None
) -> list[tuple[int, int]]:
    """Return the list, as it grows, of what runs: steps and seed.

    After each chunk `act` is told the number of the run.
    """
    original = running.record_run
    calls: list[tuple[int, int]] = []

    def spy(
        controller: Controller,
        scenario: ExplorationScenario,
        num_steps: int,
        *,
        key: jax.Array,
        num_trajectories: int,
    ) -> ExplorationRecording:
        calls.append((num_steps, int(jax.random.key_data(key)[-1])))
        number = len(calls)
        return original(
            controller,
            scenario,
            num_steps,
            key=key,
            num_trajectories=num_trajectories,
            on_progress=lambda _: act(number),
        )

    monkeypatch.setattr(running, "record_run", spy)
    return calls


def test_each_run_is_the_one_that_simulate_makes(
    experiments: Experiments, compared: Comparison
) -> None:
    assert list(compared.runs) == list(experiments)
    assert not compared.is_interrupted
    seen = []
    for name, experiment in experiments.items():
        for seed, found in zip(SEEDS, compared.runs[name], strict=True):
            alone = jx.simulate(*experiment, key=jax.random.key(seed))
            assert timeless(found) == timeless(alone.metrics)
            assert found.seed == seed
            assert found.num_steps == experiment[2]
            seen.append(found.path_length)
            if seed == SEEDS[0]:
                recording: ExplorationRecording = compared.recordings[name]
                for a, b in zip(recording.records, alone.recording.records, strict=True):
                    np.testing.assert_array_equal(a, b)
    # Seeds and controllers do matter: else the above compares nothing.
    assert len(set(seen)) == 4


def test_seeds_do_not_compile_again(experiments: Experiments, compared: Comparison) -> None:
    programs = (run_chunk, _initial_task, _initial_memory, frame_arrays)
    before = [each._cached._cache_size() for each in programs]
    again = compare(experiments, [*SEEDS, 7])
    assert [each._cached._cache_size() for each in programs] == before
    for name, metrics in compared.runs.items():
        assert [timeless(each) for each in again.runs[name][:2]] == list(map(timeless, metrics))


def test_it_goes_seed_by_seed(
    experiments: Experiments, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calls = watch(monkeypatch)
    compare(experiments, (5, 2), progress=True)
    assert calls == [(30, 5), (40, 5), (30, 2), (40, 2)]
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "4 runs" in shown.err


def test_progress_ends_with_all_done(
    experiments: Experiments, monkeypatch: pytest.MonkeyPatch
) -> None:
    shares: list[float] = []

    @contextlib.contextmanager
    def bar(label: str, *, enabled: bool) -> Iterator[Callable[[float, str], None]]:
        assert enabled
        yield lambda share, text: shares.append(share)

    monkeypatch.setattr("jaxplore.study.comparison.compare.progress_bar", bar)
    compare(experiments, (0,), progress=True)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@pytest.mark.parametrize(
    ("number", "finished"), [(1, (0, 0)), (2, (1, 0)), (3, (1, 1)), (4, (2, 1))]
)
def test_ctrl_c_keeps_the_runs_that_are_done(
    experiments: Experiments,
    compared: Comparison,
    monkeypatch: pytest.MonkeyPatch,
    number: int,
    finished: tuple[int, int],
) -> None:
    def press(call: int) -> None:
        if call == number:
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    calls = watch(monkeypatch, press)
    found = compare(experiments, SEEDS)
    assert signal.getsignal(signal.SIGINT) is before
    assert len(calls) == number
    assert found.is_interrupted
    assert tuple(len(metrics) for metrics in found.runs.values()) == finished
    for name, metrics in found.runs.items():
        whole = compared.runs[name][: len(metrics)]
        assert list(map(timeless, metrics)) == list(map(timeless, whole))
        assert (name in found.recordings) == bool(metrics)
    assert not any(each.is_interrupted for each in found.recordings.values())


def test_ctrl_c_before_the_first_step_of_a_run_keeps_the_others(
    experiments: Experiments, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, keys = running.record_run, []

    def compiling(*arguments: Any, key: jax.Array, num_trajectories: int) -> ExplorationRecording:
        keys.append(key)
        if len(keys) == 3:
            raise KeyboardInterrupt
        return original(*arguments, key=key, num_trajectories=num_trajectories)

    monkeypatch.setattr(running, "record_run", compiling)
    found = None
    # Caught here as well, so that pytest itself does not take it for a user's.
    with contextlib.suppress(KeyboardInterrupt):
        found = compare(experiments, SEEDS)
    assert found is not None
    assert found.is_interrupted
    assert [len(metrics) for metrics in found.runs.values()] == [1, 1]


@pytest.mark.parametrize(
    ("names", "seeds", "reason"),
    [
        ((), (0,), r"experiments is empty; accepted: at least one controller"),
        (("parallel",), (), r"seeds is \[\]; accepted: different whole numbers, at least one"),
        (("parallel",), (1, 2, 1), r"seeds is \[1, 2, 1\]; accepted: different whole numbers"),
    ],
)
def test_bad_input_is_named_before_anything_runs(
    experiments: Experiments,
    monkeypatch: pytest.MonkeyPatch,
    names: tuple[str, ...],
    seeds: tuple[int, ...],
    reason: str,
) -> None:
    calls = watch(monkeypatch)
    with pytest.raises(ValueError, match=reason):
        compare({name: experiments[name] for name in names}, seeds)
    assert calls == []


@dataclasses.dataclass(frozen=True)
class Written:
    """What the command left behind."""

    folder: Path
    shown: str

    @property
    def report(self) -> dict[str, Any]:
        return json.loads((self.folder / "metrics.json").read_text())

    @property
    def settings(self) -> dict[str, Any]:
        return yaml.safe_load((self.folder / "settings.yaml").read_text())


@pytest.fixture(scope="module")
def written(world_file: Path, compared: Comparison) -> Written:
    """A comparison by the command, the architectures replaced by what compiles in no time."""
    folder = world_file.parent / "out"
    arguments = ["compare", str(world_file), "--architectures", "two-layer, parallel"]
    arguments += [*SMALL, "--seeds", "2", "--seed", "5", "--out", str(folder)]
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as shown:
        patch.setenv("COLUMNS", "80")
        patch.setattr(building, "informative_mppi", pushed)
        main(arguments)
    return Written(folder, shown.getvalue())


def test_the_command_writes_a_folder_and_shows_the_table(written: Written) -> None:
    names = sorted(path.name for path in written.folder.iterdir())
    pictures = ["curves.png", "parallel.gif", "two-layer.gif"]
    assert names == sorted(["metrics.json", "settings.yaml", "table.md", *pictures])
    for name in names:
        assert str(written.folder / name) in written.shown.splitlines()
    table = (written.folder / "table.md").read_text()
    rows = [line[1:-1].split("|") for line in table.splitlines()]
    assert [row[0].strip() for row in rows[2:]] == ["two-layer", "parallel"]
    # On the terminal a row of the file is a column.
    for column in zip(rows[0], *rows[2:], strict=True):
        cells = [cell.strip() for cell in column]
        assert any(
            [cell.strip() for cell in re.split("[│┃]", line)[1:-1]] == cells
            for line in written.shown.splitlines()
        )


def test_the_settings_of_the_folder_repeat_its_runs(
    written: Written, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(building, "informative_mppi", pushed)
    used, report = written.settings, written.report
    assert "architecture" not in used
    assert used["informative"]["num_samples"] == 8
    assert not report["is_interrupted"]
    assert list(report["runs"]) == ["two-layer", "parallel"]
    for name, runs in report["runs"].items():
        assert [each["seed"] for each in runs] == [5, 6]
        for found in runs:
            chosen = make_settings({**used, "architecture": name, "seed": found["seed"]})
            *experiment, key = build(chosen)
            alone = timeless(jx.simulate(*experiment, key=key).metrics)
            assert {name: found[name] for name in alone} == alone
    assert len({each["path_length"] for runs in report["runs"].values() for each in runs}) == 4


def test_overwriting_is_asked_for(
    world_file: Path, written: Written, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(building, "informative_mppi", pushed)
    other = Written(written.folder.with_name("other"), "")
    arguments = ["compare", str(world_file), "--architectures", "parallel", "--seeds", "1"]
    arguments += [*SMALL, "--no-animation", "--out", str(other.folder)]
    main(arguments)
    with pytest.raises(SystemExit) as exit_:
        main(arguments)
    assert exit_.value.code == 2
    main([*arguments, "--seed", "9", "--overwrite"])
    assert [each["seed"] for each in other.report["runs"]["parallel"]] == [9]
    assert not list(other.folder.glob("*.gif"))
