"""A third kind of task, of which nothing in the package knows: it runs wherever others do."""

import dataclasses
import inspect
import json
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image, ImageDraw

import jaxplore as jx
from jaxplore.report import Column, Curve, LiveCurves, Metrics, Recording, thin_series
from jaxplore.simulation.batch import record_runs
from jaxplore.simulation.environment.action_modes import ControlMode
from jaxplore.simulation.environment.environment import Environment
from jaxplore.study.tuning import ControllerEpisodes, tune
from jaxplore.view.history import History


# The task begins here.
class BeaconState(NamedTuple):
    robot: jax.Array
    is_visited: jax.Array


class BeaconRecord(NamedTuple):
    state: jax.Array
    visited: jax.Array


@dataclasses.dataclass(frozen=True, kw_only=True)
class BeaconMetrics(Metrics):
    visited: int
    curve: dict[str, list[float | None]]
    columns = (Column.quartiles("finished_at", "after [s]"), Column.total("visited", "visited"))
    plotted = (Curve("visited", "beacons visited"),)

    def series(self):
        return self.curve


@dataclasses.dataclass(frozen=True, kw_only=True)
class BeaconRecording(Recording):
    beacons: np.ndarray

    def metrics(self, *, seed=None):
        visited = np.concatenate([[0], self.records.visited]).astype(float)
        done = self.time[visited == len(self.beacons)]
        common = self.common_metrics(finished_at=float(done[0]) if len(done) else None, seed=seed)
        curve = thin_series({"time": self.time, "visited": visited}, self.control_period)
        return BeaconMetrics(**common, visited=int(visited[-1]), curve=curve)

    def frame_image(self, frame, *, scale=1.0):
        side = round(200 * scale)
        image = Image.new("RGB", (side, side), "white")
        trail = 0.5 * side + 20 * scale * self.records.state[: frame.step + 1, :2].astype(float)
        if len(trail) > 1:
            ImageDraw.Draw(image).line([tuple(each) for each in trail.tolist()], "black")
        return image


class Beacons(jx.Scenario):
    """A point mass that must visit beacons, in any order."""

    robot: jx.PointMass
    beacons: jax.Array
    start: jax.Array = dataclasses.field(default_factory=lambda: jnp.zeros(4))
    control_period: jax.Array = dataclasses.field(default_factory=lambda: jnp.array(0.05))
    faults: None = None
    metrics_type = BeaconMetrics

    def init(self, key):
        return BeaconState(self.start, jnp.zeros(len(self.beacons), bool)), self.beacons[0]

    def perceive(self, state, moment, key):
        distance = jnp.linalg.norm(self.beacons - state.robot[:2], axis=-1)
        nearest = jnp.argmin(jnp.where(state.is_visited, jnp.inf, distance))
        return state._replace(is_visited=state.is_visited | (distance < 0.2)), self.beacons[nearest]

    def advance(self, state, control, moment, info):
        robot = self.robot.step(state.robot, control, self.control_period)
        count = jnp.sum(state.is_visited, dtype=jnp.int32)
        return state._replace(robot=robot), BeaconRecord(robot, count)

    def is_unfinished(self, state):
        return ~state.is_visited.all()

    def recording(self, controller, before, run):
        return BeaconRecording(**run.common(self.period), beacons=np.asarray(self.beacons))


class ToBeacon(jx.Cost):
    """Distance to the beacon that is next, the belief of this task."""

    def stage(self, state, control, t, belief):
        x, y = state.position
        return jnp.hypot(x - belief[0], y - belief[1])


# The task ends here.
ROBOT = jx.PointMass(2, max_speed=2.0, max_acceleration=4.0)
BEACONS = jnp.array([[1.0, 0.5], [2.0, -0.5], [0.5, -1.5]])
TASK = Beacons(ROBOT, BEACONS)
CONTROLLER = jx.MPPI(
    ROBOT,
    1.0 * ToBeacon(),
    horizon=15,
    num_samples=64,
    temperature=0.05,
    noise_std=[2.0, 2.0],
    dt=0.05,
)


def test_a_third_task_is_short() -> None:
    lines = Path(__file__).read_text().split("# The task begins here.")[1]
    code = [line for line in lines.split("# The task ends here.")[0].splitlines() if line.strip()]
    # Without its own cost, which any user writes.
    assert len(code) - len(inspect.getsource(ToBeacon).splitlines()) < 60


def test_it_is_simulated_and_saved(tmp_path: Path) -> None:
    run = jx.simulate(CONTROLLER, TASK, 400, key=jax.random.key(0))
    assert run.metrics.is_finished
    assert run.metrics.visited == 3
    assert run.recording.num_steps < 400
    run.save(tmp_path / "run")
    assert {each.name for each in (tmp_path / "run").iterdir()} == {
        "metrics.json",
        "arrays.npz",
        "state.npz",
        "animation.gif",
    }
    loaded = jx.Run.load(tmp_path / "run")
    assert loaded.metrics == run.metrics
    np.testing.assert_array_equal(loaded.recording.records.state, run.recording.records.state)
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["visited"] == 3
    assert "visited" in str(run.metrics)


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlottedRecording(BeaconRecording):
    @property
    def live_curves(self):
        return LiveCurves("beacons", ("visited",), np.asarray(self.records.visited)[None])


def test_a_view_plots_the_curves_that_its_recording_has() -> None:
    recording = jx.simulate(CONTROLLER, TASK, 400, key=jax.random.key(0)).recording
    assert History(recording).plots() == ()
    fields = {each.name: getattr(recording, each.name) for each in dataclasses.fields(recording)}
    (plot,) = History(PlottedRecording(**fields)).plots()
    assert (plot.title, plot.names) == ("beacons", ("visited",))
    assert plot.rows[-1].tolist() == pytest.approx([recording.time[-1], 3.0])


def test_it_runs_side_by_side_as_alone() -> None:
    keys = jnp.stack([jax.random.key(0), jax.random.key(1)])
    together = record_runs(CONTROLLER, TASK, 400, keys=keys)
    alone = jx.simulate(CONTROLLER, TASK, 400, key=keys[0], num_trajectories=0).recording
    steps = 20  # Rounding differs, and the softmax makes more of it.
    np.testing.assert_allclose(
        together[0].records.state[:steps], alone.records.state[:steps], atol=1e-3
    )
    assert [each.metrics().visited for each in together] == [3, 3]


def test_two_controllers_are_compared(tmp_path: Path) -> None:
    slow = jx.set_parameters(CONTROLLER, {"temperature": 5.0})
    found = jx.compare({"sharp": (CONTROLLER, TASK, 300), "blunt": (slow, TASK, 300)}, [0, 1])
    header, *rows = found.rows()
    assert header == ("", "after [s]", "visited")
    assert [row[0] for row in rows] == ["sharp", "blunt"]
    found.save(tmp_path / "compared")
    assert (tmp_path / "compared" / "curves.png").exists()


def test_it_is_tuned() -> None:
    episodes = ControllerEpisodes(CONTROLLER, {"beacons": TASK}, time_limit=15.0)
    result: Any = tune(
        episodes,
        ["temperature=0.01:3:log"],
        "finished_at",
        budget=4,
        seeds=1,
        population=2,
        unseen=2,
    )
    assert len(result.trials) == 4
    assert result.chosen.state == "done"


def test_an_environment_takes_it() -> None:
    environment = Environment(TASK, ControlMode(ROBOT))
    state, outcome = eqx.filter_jit(environment.reset)(jax.random.key(0), jnp.zeros((), jnp.int32))
    assert set(outcome.observation) == {"state"}
    state, outcome = eqx.filter_jit(environment.step)(state, jnp.array([1.0, 0.0]))
    assert float(outcome.reward) == pytest.approx(-0.05)
    assert not bool(outcome.is_terminated)
    # What nobody draws otherwise is drawn as a frame of a recording without a step.
    picture = TASK.agent_view(None).picture(state.perceived, state.moment, np.zeros((1, 2)))
    assert picture.shape == (200, 200, 3)
