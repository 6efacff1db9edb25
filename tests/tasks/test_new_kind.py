"""A kind of task of which nothing in the package knows is one folder, here a file, and one row."""

import dataclasses
import json
import runpy
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml
from click.shell_completion import ShellComplete
from PIL import Image

import jaxplore as jx
from jaxplore.cli import _known, cli, main
from jaxplore.gym.build import build_environment
from jaxplore.report import Metrics, Recording
from jaxplore.scenes.scene import Scene
from jaxplore.settings.defaults import arguments, setting
from jaxplore.settings.sections import Duration, Positive, RunSettings, Section
from jaxplore.simulation.experiment import Experiment
from jaxplore.tasks import reference, registry
from jaxplore.tasks.kind import Kind, Shown
from jaxplore.topics.content import Content
from jaxplore.view.replay import Replay

PAGE = Path(__file__).parents[2] / "docs" / "settings_page.py"


# The folder begins here.
class WalkState(NamedTuple):
    robot: jax.Array


class WalkRecord(NamedTuple):
    state: jax.Array
    control: jax.Array


@dataclasses.dataclass(frozen=True, kw_only=True)
class WalkRecording(Recording):
    def metrics(self, *, seed=None):
        return Metrics(**self.common_metrics(finished_at=None, seed=seed))

    def frame_image(self, frame, *, scale=1.0):
        return Image.new("RGB", (round(80 * scale), round(60 * scale)), "white")


class Walk(jx.Scenario):
    """A point mass that walks to a gate.

    Args:
        robot: the robot.
        gate: distance of the gate ahead [m].
    """

    robot: jx.PointMass
    gate: jax.Array
    start: jax.Array
    control_period: jax.Array
    metrics_type = Metrics

    def __init__(self, robot: jx.PointMass, gate: float = 2.0) -> None:
        self.robot, self.gate, self.start = robot, jnp.array(gate), jnp.zeros(4)
        self.control_period = jnp.array(0.1)

    def init(self, key):
        return WalkState(self.start), self.gate

    def perceive(self, state, moment, key):
        return state, self.gate

    def advance(self, state, control, moment, info):
        robot = self.robot.step(state.robot, control, self.control_period)
        return WalkState(robot), WalkRecord(robot, control)

    def is_unfinished(self, state):
        return state.robot[0] < self.gate

    def recording(self, controller, before, run):
        return WalkRecording(**run.common(self.period))


class ToGate(jx.Cost):
    """Distance to the gate."""

    def stage(self, state, control, t, belief):
        x, y = state.position
        return jnp.hypot(x - belief, y)


class WalkerSettings(Section):
    """The walker: see `jaxplore.PointMass`."""

    max_speed: Positive | None = setting(jx.PointMass, "max_speed")


class WalkSettings(RunSettings):
    """Settings of a walk.

    Args:
        walk: name of the walk.
        walker: the walker.
        time_limit: simulated time [s].
    """

    walk: str = "short"
    gate: Positive = setting(Walk, "gate")
    time_limit: Duration = 1.0
    walker: WalkerSettings = WalkerSettings()


class WalkScene(Scene):
    layers = ("gate",)

    def __init__(self, server, recording):
        super().__init__(server)
        self.look_at(np.array([[-1.0, -1.0], [2.0, 1.0]]))

    def draw(self, frame, trail):
        self.lines("gate", np.array([[[2.0, -1.0, 0.0], [2.0, 1.0, 0.0]]]), (9, 9, 9, 255), 2.0)


class WalkContent(Content):
    def write_start(self):
        self.channels.log_values("/gate", {"x": 2.0}, 0.0)


def build_walk(settings: WalkSettings) -> Experiment:
    robot = jx.PointMass(2, **arguments(settings.walker, jx.PointMass))
    controller = jx.MPPI(
        robot, 1.0 * ToGate(), horizon=8, num_samples=32, temperature=0.05, noise_std=[2.0] * 2,
        dt=0.1,
    )  # fmt: skip
    key = jax.random.key(settings.seed)
    task = Walk(robot, **arguments(settings, Walk))
    return Experiment(controller, task, round(10 * settings.time_limit), key)


WALK = Kind(
    name="walk",
    title="Walks",
    place="on a walk",
    selector="walk",
    settings=WalkSettings,
    build=build_walk,
    places={"short": {"walk": "short"}, "stroll": {"walk": "stroll", "gate": 9.0}},
    words={"walk": {"walk": "short"}},
    suffixes=(".walk",),
    files="a walk",
    shown=(Shown(WalkRecording, WalkScene, WalkContent),),
)
# The folder ends here.


@pytest.fixture(autouse=True)
def _row(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Add the row, and renew the generated file, as `python docs/settings_page.py` does."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(registry.KINDS, WALK.name, WALK)
    forget()
    known = tmp_path / "known.json"
    known.write_text(_known.as_text(_known.from_settings()))
    monkeypatch.setattr(_known, "FILE", known)
    yield
    monkeypatch.undo()
    forget()


def page() -> str:
    """Return the page of settings, as the script writes it."""
    return runpy.run_path(str(PAGE))["page"]()


def forget() -> None:
    """Forget what was made of the rows of the registry."""
    for kept in (reference.rows, reference.sections, reference.place_settings, _known.load_known):
        kept.cache_clear()


def test_its_settings_are_checked_and_explained(capsys, fails) -> None:
    settings = registry.make_settings({"map": "stroll", "walker": {"max_speed": 3.0}})
    assert isinstance(settings, WalkSettings)
    assert (settings.gate, settings.walker.max_speed) == (9.0, 3.0)
    main(["settings", "gate"])
    shown = capsys.readouterr().out
    for text in ("gate (on a walk)", "distance of the gate ahead", "2.0", "stroll: 9.0"):
        assert text in shown
    main(["settings", "stroll"])
    given = yaml.safe_load(capsys.readouterr().out)
    assert registry.make_settings(given) == registry.make_settings({"map": "stroll"})
    text = page()
    assert "## Walks" in text
    assert "| `walker.max_speed` | " in text
    assert "unknown setting pace; accepted here: start," in fails("run", "walk", "--set", "pace=1")
    assert "lidar.num_beams is 9 on a walk; accepted: on a map" in fails(
        "run", "walk", "--beams", "9"
    )
    assert "laps is 2 on a walk; accepted: along a path" in fails("run", "walk", "--laps", "2")
    beside = fails("run", "walk", "--set", "volume=forest")
    assert "the volume 'forest' beside the walk 'short'" in beside
    assert "a walk, or office" in fails("run", "nowhere.yaml")


def test_the_shell_and_the_help_know_it(capsys) -> None:
    shell = ShellComplete(cli, {}, "jaxplore", "_JAXPLORE_COMPLETE")

    def completed(*before: str, last: str) -> set[str]:
        return {item.value for item in shell.get_completions([*before], last)}

    assert {"stroll"} <= completed("run", last="str")
    assert {"walker.max_speed="} <= completed("run", "stroll", "--set", last="walker")
    assert "gate" in json.loads(_known.FILE.read_text())["settings"]


@pytest.fixture
def walk(capsys) -> tuple[Path, str]:
    """Run a stroll by the command line, recorded for Foxglove."""
    pytest.importorskip("foxglove")
    main(["run", "stroll", "--seed", "3", "--record", "walk.mcap"])
    return Path("runs/stroll"), capsys.readouterr().out


@pytest.mark.long
def test_it_runs_and_is_recorded_and_viewed(walk: tuple[Path, str]) -> None:
    folder, shown = walk
    assert "duration" in shown
    settings = registry.make_settings(yaml.safe_load((folder / "settings.yaml").read_text()))
    assert (settings.gate, settings.seed) == (9.0, 3)
    run = jx.Run.load(folder)
    # What the command has run is what Python builds.
    again = registry.build(settings)
    assert isinstance(run.recording, WalkRecording)
    assert run.recording.num_steps == again.num_steps == 10
    assert run.recording.records.state[-1, 0] > run.recording.records.state[0, 0]
    mcap = pytest.importorskip("mcap.reader")
    with Path("walk.mcap").open("rb") as file:
        topics = {channel.topic for _, channel, _ in mcap.make_reader(file).iter_messages()}
    assert {"/gate", "/command", "/metrics"} <= topics
    pytest.importorskip("viser")
    replay = Replay(run.recording, port=0)
    assert isinstance(replay._display._scene, WalkScene)
    assert set(replay._display._scene._nodes) == {"gate"}
    replay.close()


def test_agents_learn_it() -> None:
    environment = build_environment(walk="short", time_limit=0.5)
    assert isinstance(environment.scenario(0), Walk)
