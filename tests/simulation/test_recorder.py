"""A recorder watches a run: every step is in the file, and the run stays the same."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest
from mcap.reader import make_reader

from jaxplore import simulate
from jaxplore.recorder import McapRecorder
from jaxplore.simulation.monitor import Monitor, Requests

pytestmark = pytest.mark.long

STEPS = 43
KEY = jax.random.key(3)


def logged(path: Path, topic: str) -> tuple[np.ndarray, list]:
    """Times [s] and contents of the messages of a topic in JSON."""
    with path.open("rb") as file:
        found = [
            (message.log_time * 1e-9, json.loads(message.data))
            for _, _, message in make_reader(file).iter_messages([topic], log_time_order=False)
        ]
    return np.array([time for time, _ in found]), [content for _, content in found]


class Stop(Monitor):
    """Stops a run at its first update, or fails then or at its beginning."""

    def __init__(self, *, fails: bool = False, begins: bool = True) -> None:
        self._fails, self._begins, self._is_stopped = fails, begins, False

    def begin(self, recording, controller) -> None:
        if not self._begins:
            raise ValueError("it does not begin")

    def is_due(self, simulated: float, elapsed: float) -> bool:
        return True

    def show(self, update) -> None:
        self._is_stopped = update.frame.step >= 7
        if self._fails:
            raise RuntimeError("broken")

    def requests(self) -> Requests:
        return Requests(is_stopped=self._is_stopped)

    def end(self, recording) -> None:
        pass


def test_every_step_of_a_run_and_of_its_continuation_is_recorded_once(
    make, check_equal, tmp_path: Path
) -> None:
    controller, scenario = make()
    given = {"key": KEY, "num_trajectories": 8}
    plain = simulate(controller, scenario, STEPS, **given)
    watched = simulate(
        controller, scenario, STEPS, **given, monitors=[McapRecorder(tmp_path / "whole.mcap")]
    )
    check_equal(watched, plain)
    first = simulate(
        controller,
        scenario,
        STEPS,
        **given,
        monitors=[McapRecorder(tmp_path / "first.mcap"), Stop()],
    )
    assert first.recording.is_interrupted
    rest = McapRecorder(tmp_path / "rest.mcap")
    check_equal(
        simulate(controller, scenario, STEPS, **given, resume=first, monitors=[rest]), plain
    )
    times, controls = logged(tmp_path / "whole.mcap", "/command")
    np.testing.assert_allclose(times, plain.recording.time[1:], atol=1e-9)
    rows = np.array([list(each.values()) for each in controls])
    np.testing.assert_array_equal(rows, plain.recording.records.control)
    parts = [logged(tmp_path / f"{name}.mcap", "/command") for name in ("first", "rest")]
    np.testing.assert_array_equal(np.concatenate([part[0] for part in parts]), times)
    assert parts[0][1] + parts[1][1] == controls
    times, metrics = logged(tmp_path / "whole.mcap", "/metrics")
    # The last three steps come after the last update.
    np.testing.assert_allclose(times, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.86])
    assert np.float32(metrics[-1]["coverage"]) == plain.recording.records.coverage[-1]
    assert "coverage" in metrics[0]["text"]


def test_a_run_that_fails_leaves_no_file(make, tmp_path: Path) -> None:
    controller, scenario = make()
    with pytest.raises(RuntimeError, match="broken"):
        simulate(
            controller,
            scenario,
            STEPS,
            key=KEY,
            num_trajectories=8,
            monitors=[McapRecorder(tmp_path / "run.mcap"), Stop(fails=True)],
        )
    assert not list(tmp_path.iterdir())


def test_a_monitor_that_does_not_begin_leaves_no_file_of_another(make, tmp_path: Path) -> None:
    controller, scenario = make()
    recorder = McapRecorder(tmp_path / "run.mcap")
    monitors = [recorder, Stop(begins=False)]
    with pytest.raises(ValueError, match="it does not begin"):
        simulate(controller, scenario, STEPS, key=KEY, num_trajectories=8, monitors=monitors)
    assert not list(tmp_path.iterdir())
    assert recorder.failure is None
