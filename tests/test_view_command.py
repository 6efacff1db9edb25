"""`jaxplore run --view` and `jaxplore view`, without browsers."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import jaxplore.cli._view as command
from jaxplore.cli import main
from jaxplore.simulation.monitor import Requests
from jaxplore.simulation.run import Run
from jaxplore.view import LiveView, Replay

pytestmark = pytest.mark.long

SMALL = ["--samples", "32", "--set", "controller.horizon=10", "--set", "fields.num_directions=8"]
ROOM = ["office", "--set", "office.width=9", "--set", "office.height=8", "--range", "2.0", *SMALL]
TEMPERATURE = "weighting.temperature"


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What a page asks for, run by run."""
    told = {"parameters": {}, "seeds": [], "again": [], "records": False}

    class Asked(LiveView):
        def requests(self) -> Requests:
            if told["records"]:
                told["records"] = False
                self.recorder.start()
            return Requests(told["parameters"], is_stopped=bool(told["seeds"]))

        def seed_request(self) -> int | None:
            return told["seeds"].pop(0) if told["seeds"] else None

        def wait_for_restart(self) -> int | None:
            return told["again"].pop(0) if told["again"] else None

    monkeypatch.setattr(command, "LiveView", Asked)
    return told


def run(*arguments: str) -> None:
    main(["run", *ROOM, "--time-limit", "0.6", "--no-animation", *arguments])


def test_parameters_that_were_changed_are_told_and_kept(page, capsys) -> None:
    page["parameters"], page["records"] = {TEMPERATURE: 0.9, "cost.guidance.weight": 1.0}, True
    run("--view", "--out", "out", "--set", "parameters={controller.temperature: 0.4}")
    told = capsys.readouterr().err.splitlines()
    assert told[0].startswith("View: http://127.0.0.1:")
    assert [line for line in told if line.startswith("Changed")] == [
        f"Changed during the run: {TEMPERATURE} 0.4 -> 0.9"
    ]
    # What the button has recorded is beside the run folder, which was not there yet.
    (file,) = Path.cwd().glob("out-20*.mcap")
    assert f"Recorded to {file}" in told
    settings = yaml.safe_load(Path("out/settings.yaml").read_text())
    assert settings["parameters"] == {
        TEMPERATURE: pytest.approx(0.9),
        "cost.guidance.weight": 1.0,
    }
    # The same settings repeat the controller of the end, from the start on.
    page["parameters"] = {}
    main(["run", "--settings", "out/settings.yaml", "--out", "again", "--no-animation"])
    again = yaml.safe_load(Path("again/settings.yaml").read_text())
    assert again["controller"]["temperature"] == pytest.approx(0.9)
    assert again["parameters"] == {}


def test_a_run_that_is_started_again_has_another_seed_and_is_kept_alone(page, capsys) -> None:
    page["seeds"], page["again"] = [5], [6]
    run("--view", "--out", "out")
    assert "Not saved: the run with seed 0, started again." in capsys.readouterr().err
    seeds = {
        name: yaml.safe_load(Path(name, "settings.yaml").read_text())["seed"]
        for name in ("out", "out-2")
    }
    assert seeds == {"out": 5, "out-2": 6}
    # Each is what the command without a view does with that seed.
    run("--seed", "6", "--out", "alone")
    states = [Run.load(name).recording.records.state for name in ("out-2", "alone")]
    np.testing.assert_array_equal(*states)
    assert Run.load("out").metrics.seed == 5


def test_a_finished_run_is_served_until_it_is_interrupted(page, capsys, monkeypatch) -> None:
    run("--out", "out")
    capsys.readouterr()
    shown = []

    def serve(replay: Replay) -> None:
        shown.append(replay._display._time.value)
        raise KeyboardInterrupt

    monkeypatch.setattr(Replay, "serve", serve)
    main(["view", "out", "--host", "0.0.0.0"])
    assert shown == ["0.00 s"]
    link, warning = capsys.readouterr().err.splitlines()
    assert link.startswith("View: http://")
    assert warning == (
        "jaxplore: warning: --host is 0.0.0.0: anybody in the network can open the view and look "
        "at it"
    )


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["run", "office", "--host", "0.0.0.0"], "--host is 0.0.0.0 without --view"),
        (["run", "office", "--view-port", "80"], "--view-port is 80 without --view"),
        (["run", "office", "--view", "--view-port", "-1"], "port is -1; accepted: a whole number"),
        (["run", "office", "--view", "--host", "192.0.2.1"], "host is '192.0.2.1'"),
        (["view", "gone"], "gone"),
    ],
)
def test_bad_input_is_one_line(fails, arguments, reason: str) -> None:
    assert reason in fails(*arguments)


def test_without_viser_the_extra_is_named() -> None:
    program = (
        "import sys; sys.modules['viser'] = None; from jaxplore.cli import main; "
        "main(['run', 'office', '--view'])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == (
        "jaxplore: viser is not installed; accepted: pip install '.[view]' in a clone of jaxplore\n"
    )
