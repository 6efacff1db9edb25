"""Live views of runs, with pages that speak viser's protocol in place of browsers."""

import contextlib
import gc
import itertools
import json
import math
import socket
import time
import warnings
from collections.abc import Callable
from typing import Any

import jax
import msgspec
import numpy as np
import pytest
import viser
import zstandard
from mcap.reader import make_reader
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from jaxplore import simulate
from jaxplore.parameters import get_parameters, set_parameters
from jaxplore.recorder import SwitchedRecorder
from jaxplore.report.drawing.rollout_costs import cost_colours
from jaxplore.scenes.scene import linear_light
from jaxplore.simulation.loop import frame_arrays, run_chunk
from jaxplore.simulation.monitor import Requests
from jaxplore.view import LiveView, is_public
from jaxplore.view.live import SPEEDS
from jaxplore.view.server import close_server, link, open_server
from jaxplore.view.sliders import choose_knobs, slider_range

KEY = jax.random.key(3)
STEPS = 40
WEIGHT = "cost.information.weight"
PATIENCE = 60.0
"""Time after which a test that waits has failed [s]: no test passes because of a duration."""


def wait_until(is_true: Callable[[], Any]) -> None:
    end = time.monotonic() + PATIENCE
    while not is_true():
        assert time.monotonic() < end
        time.sleep(0.005)


class Page:
    """What a browser does: it takes messages, and sends values of sliders and clicks."""

    def __init__(self, address: str, origin: str | None = None) -> None:
        self.scene: dict[str, dict[str, Any]] = {}
        self.panel: dict[str, dict[str, Any]] = {}
        self._kept: list[dict[str, Any]] = []
        headers = {} if origin is None else {"Origin": origin}
        self._socket = connect(
            address.replace("http", "ws"),
            subprotocols=[f"viser-v{viser.__version__}"],
            additional_headers=headers,
            max_size=2**26,
            max_queue=None,
            close_timeout=1.0,
        )
        self._send(
            "ViewerCameraMessage",
            wxyz=(1.0, 0.0, 0.0, 0.0),
            position=(0.0, 0.0, 1.0),
            fov=1.0,
            near=0.1,
            far=10.0,
            image_height=100,
            image_width=100,
            look_at=(0.0, 0.0, 0.0),
            up_direction=(0.0, 0.0, 1.0),
        )

    def _send(self, kind: str, **fields: Any) -> None:
        self._socket.send(msgspec.msgpack.encode({"type": kind, **fields}))

    def read(self) -> None:
        """Take the messages of one window."""
        data = self._socket.recv(timeout=PATIENCE)
        size = int.from_bytes(data[8:16], "little")
        window = msgspec.msgpack.decode(zstandard.decompress(data[16 : 16 + size]))
        for message in window["messages"]:
            if message["type"] == "GuiUpdateMessage":
                self.panel[message["uuid"]] |= message["updates"]
            elif message["type"].startswith("Gui") and "props" in message:
                self.panel[message["uuid"]] = {**message, **message["props"]}
            elif "name" in message and "props" in message:
                self.scene[message["name"]] = message["props"]

    def find(self, label: str) -> str:
        """Wait for an element of the panel, and return its number."""
        while True:
            for number, each in self.panel.items():
                if each.get("label") == label:
                    return number
            self.read()

    def set(self, label: str, value: Any) -> None:
        self._send("GuiUpdateMessage", uuid=self.find(label), updates={"value": value})

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def view():
    view = LiveView()
    yield view
    view.close()


@pytest.fixture
def page(view):
    page = Page(view.link)
    wait_until(lambda: view.num_pages == 1)
    yield page
    page.close()


@pytest.fixture(scope="module")
def experiment(make):
    return make()


def run(experiment, *monitors, steps=STEPS, controller=None):
    given, scenario = experiment
    return simulate(
        given if controller is None else controller,
        scenario,
        steps,
        key=KEY,
        num_trajectories=8,
        monitors=monitors,
    )


@pytest.fixture(scope="module")
def plain(experiment):
    return run(experiment)


class Script(LiveView):
    """A view whose run waits after given steps for what a page does."""

    def __init__(self, recorder: SwitchedRecorder | None = None, **acts: Callable[[], Any]) -> None:
        super().__init__(recorder=recorder)
        self.acts = {int(name[1:]): act for name, act in acts.items()}

    def is_due(self, simulated: float, elapsed: float) -> bool:
        super().is_due(simulated, elapsed)
        return True

    def show(self, update) -> None:
        super().show(update)
        for step in [each for each in self.acts if each <= update.frame.step]:
            self.acts.pop(step)()


def test_a_view_changes_nothing_and_a_page_shows_the_run(
    view, page, experiment, plain, check_equal
) -> None:
    check_equal(run(experiment, view), plain)
    needed = {"/belief", "/rollouts", "/plan", "/trail", "/scan", "/robot"}
    while not needed <= set(page.scene):
        page.read()
    assert page.scene["/belief"]["render_width"] == pytest.approx(6.0)
    progress = page.find("Progress")
    while page.panel[progress]["value"] != "finished after 0.8 s":
        page.read()
    assert page.panel[page.find("Time")]["value"] == "0.80 s"
    # The share button of viser would publish the page in the internet.
    page._send("ShareUrlRequest")
    assert view._server.request_share_url() is None


def test_a_slider_acts_on_the_run_without_compiling_and_is_kept_with_it(experiment, plain) -> None:
    def move() -> None:
        page.set("weight", 0.0)
        wait_until(lambda: view.requests().parameters)

    view = Script(s10=move)
    page = Page(view.link)
    # Several sliders are labelled weight: that of the information is found by its hint.
    original = page.find

    def find(label: str) -> str:
        while True:
            for number, each in page.panel.items():
                if each.get("hint") == WEIGHT:
                    return number
            page.read()

    page.find = find
    try:
        size = run_chunk._cached._cache_size()
        changed = run(experiment, view)
        assert run_chunk._cached._cache_size() == size
    finally:
        page.find = original
        page.close()
        view.close()
    assert changed.parameters == {WEIGHT: 0.0}
    states = [each.recording.records.state for each in (changed, plain)]
    np.testing.assert_array_equal(states[0][:10], states[1][:10])
    assert not np.array_equal(states[0], states[1])
    controller = set_parameters(experiment[0], changed.parameters)
    assert float(get_parameters(controller)[WEIGHT]) == 0.0


def test_a_page_pauses_steps_and_stops_the_run(experiment) -> None:
    seen = []

    def pause() -> None:
        page.set("Single step", True)
        wait_until(lambda: view.requests().is_paused and view.requests().single_steps == 1)

    def step() -> None:
        seen.append(view.requests())
        page.set("Single step", True)
        wait_until(lambda: view.requests().single_steps == 2)

    def stop() -> None:
        page.set("Pause", True)
        wait_until(lambda: not view.requests().is_paused)
        page.set("Stop", True)
        wait_until(lambda: view.requests().is_stopped)

    # The step after the one at which the pause begins is the single one.
    view = Script(s10=pause, s11=step, s12=stop)
    page = Page(view.link)
    try:
        done = run(experiment, view)
        assert view.seed_request() is None
        assert view.wait_for_restart() is None
    finally:
        page.close()
        view.close()
    assert done.recording.num_steps == 12
    assert done.recording.is_interrupted
    assert seen == [Requests(is_paused=True, single_steps=1)]


def test_a_page_starts_the_run_again_with_another_seed(experiment) -> None:
    def restart() -> None:
        page.set("Seed", 7)
        # In this order: a number that is typed arrives before the click.
        page.set("Restart", True)
        wait_until(lambda: view.requests().is_stopped)

    view = Script(s10=restart)
    page = Page(view.link)
    try:
        run(experiment, view)
        assert view.seed_request() == 7
        assert view.wait_for_restart() == 7
        again = run(experiment, view, steps=20)
        assert view.seed_request() is None
    finally:
        page.close()
        view.close()
    assert again.recording.num_steps == 20


def test_a_button_records_from_the_middle_of_a_run(experiment, plain, tmp_path) -> None:
    def switch() -> None:
        page.set("Record", True)
        wait_until(lambda: recorder.is_on)

    def switch_off() -> None:
        # The button is called otherwise by now.
        page._send("GuiUpdateMessage", uuid=button, updates={"value": True})
        wait_until(lambda: not recorder.is_on)

    recorder = SwitchedRecorder(tmp_path)
    view = Script(recorder=recorder, s10=switch, s20=switch_off)
    page = Page(view.link)
    try:
        button = page.find("Record")
        told = page.find("Recording")
        page.set("Record", True)
        while "no run goes on" not in page.panel[told]["value"]:
            page.read()
        seen = run(experiment, view, recorder)
        while not page.panel[told]["value"].startswith("Recorded to"):
            page.read()
        assert page.panel[button]["label"] == "Record"
    finally:
        page.close()
        view.close()
    np.testing.assert_array_equal(seen.recording.records.state, plain.recording.records.state)
    (file,) = tmp_path.iterdir()
    assert page.panel[told]["value"] == f"Recorded to {file}"
    topics = {"/world", "/belief", "/tf", "/plan", "/rollouts", "/rollout_costs", "/command"}
    with file.open("rb") as stream:
        found = list(make_reader(stream).iter_messages())
    assert topics <= {channel.topic for _, channel, _ in found}
    rows = [json.loads(each.data) for _, channel, each in found if channel.topic == "/command"]
    (first, last) = (
        round(np.argmax((plain.recording.records.control == list(row.values())).all(axis=1)))
        for row in (rows[0], rows[-1])
    )
    # A click acts between two chunks; the last update is up to 0.1 s old, that is five steps.
    assert 10 <= first < 20
    assert 15 <= last + 1 < 30
    np.testing.assert_array_equal(
        [list(each.values()) for each in rows], plain.recording.records.control[first : last + 1]
    )


def test_the_colours_of_rollouts_are_chosen_without_compiling(
    view, page, experiment, plain
) -> None:
    size = frame_arrays._cached._cache_size()
    run(experiment, view, steps=4)
    choice = page.find("Colour rollouts by")
    while "/rollouts" not in page.scene:
        page.read()
    *others, term = page.panel[choice]["options"]
    assert others[:2] == ["weight", "total cost"]
    page.set("Colour rollouts by", term)
    wait_until(lambda: view._display._frame.step == 4)
    wanted = linear_light(cost_colours(view._display._frame.sample_terms[term].astype(float)))
    wait_until(lambda: (view._display._scene._nodes["rollouts"].colors[::30, 0] == wanted).all())
    assert frame_arrays._cached._cache_size() == size


def test_the_speed_is_one_of_the_list(view, page) -> None:
    assert view.requests().speed == math.inf
    name = next(name for name, speed in SPEEDS.items() if speed == 2.0)
    page.set("Speed", name)
    wait_until(lambda: view.requests().speed == 2.0)
    page.set("Speed", "at once")
    wait_until(lambda: view.requests().speed == math.inf)


def test_a_robot_has_no_speed_and_no_restart() -> None:
    view = LiveView(is_simulation=False)
    page = Page(view.link)
    try:
        page.find("Reset all")
        labels = {each.get("label") for each in page.panel.values()}
        assert {"Pause", "Single step", "Save picture"} <= labels
        assert not {"Stop", "Restart", "Speed", "Seed"} & labels
        assert view.requests() == Requests()
    finally:
        page.close()
        view.close()


def test_frames_are_rare_without_a_page_frequent_with_one_and_bounded_in_cost(
    view, monkeypatch
) -> None:
    pages = itertools.chain([0, 0, 1, 1], itertools.repeat(1))
    monkeypatch.setattr(LiveView, "num_pages", property(lambda _: next(pages)))
    assert [view.is_due(0.1, elapsed) for elapsed in (0.5, 1.5, 0.05, 0.15)] == [
        False,
        True,
        False,
        True,
    ]
    view._cost = 0.08
    assert [view.is_due(0.1, elapsed) for elapsed in (0.9, 1.1)] == [False, True]
    view._is_paused = True
    assert view.is_due(0.02, 0.0)


def test_a_run_goes_on_when_its_view_fails(view, experiment, monkeypatch) -> None:
    def fail(*_: Any) -> None:
        raise RuntimeError("no picture")

    monkeypatch.setattr(view._display, "begin", fail)
    told = []
    monkeypatch.setattr("jaxplore.view.live.warnings.warn", lambda text, **_: told.append(text))
    assert run(experiment, view, steps=4).recording.num_steps == 4
    wait_until(lambda: told)
    assert told[0] == "the view could not show a frame: RuntimeError: no picture"


def test_pages_of_other_sites_are_turned_away(view) -> None:
    for origin in ("http://evil.example", "http://127.0.0.1:1", "null"):
        with pytest.raises(ConnectionClosed, match="another web site"):
            Page(view.link, origin).find("Pause")
    assert view.num_pages == 0
    own = Page(view.link, view.link)
    own.find("Pause")
    own.close()


def test_addresses_and_ports_that_cannot_be_used_are_one_line() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ValueError, match=rf"port is {port} at 127.0.0.1 .*; accepted: a free"):
            LiveView(port=port)
    with pytest.raises(ValueError, match=r"host is '192.0.2.1' .*; accepted: an address of this"):
        LiveView(host="192.0.2.1")
    with pytest.raises(ValueError, match="port is 70000; accepted: at most 65535"):
        LiveView(port=70000)
    with pytest.raises(ValueError, match="port is -1; accepted: a whole number >= 0"):
        LiveView(port=-1)


def test_the_link_of_every_address_can_be_opened() -> None:
    server = open_server("0.0.0.0", label="x")
    try:
        assert link(server) == f"http://{socket.gethostname()}:{server.get_port()}"
    finally:
        close_server(server)
    assert [is_public(host) for host in ("127.0.0.1", "localhost", "::1")] == [False] * 3
    assert [is_public(host) for host in ("0.0.0.0", "192.168.1.2", "robot.local")] == [True] * 3


def test_sliders_are_those_of_weights_temperatures_and_limits(experiment) -> None:
    knobs = choose_knobs(get_parameters(experiment[0]))
    chosen = {(knob.path, knob.element) for knob in knobs}
    assert {
        (WEIGHT, None),
        ("cost.obstacle.clearance", None),
        ("weighting.temperature", None),
        ("dynamics.max_speed", None),
        ("proposal.noise_std", 1),
    } <= chosen
    assert not {path for path, _ in chosen} & {"dt", "dynamics.radius", "control_period"}
    assert {knob.group for knob in knobs if knob.path.startswith("cost.")} == {
        "obstacle",
        "information",
        "guidance",
        "control",
    }


@pytest.mark.parametrize(
    ("value", "kind", "low", "high"),
    [
        (2.0, "weight", 0.0, 10.0),
        (0.0, "weight", 0.0, 1.0),
        (-2.0, "weight", -10.0, 10.0),
        (0.3, "temperature", 0.01, 2.0),
        (0.5, "weight", 0.0, 2.0),
        # A robot cannot be faster than it is.
        (1.5, "max_speed", 0.0075, 1.5),
    ],
)
def test_a_slider_reaches_from_nothing_to_several_times_its_value(value, kind, low, high) -> None:
    made = slider_range(float(np.float32(value)), kind)
    assert (made.low, made.high, made.initial) == pytest.approx((low, high, value))
    assert made.low <= made.initial <= made.high


def test_values_that_a_page_makes_up_are_held_within_the_sliders(view, page, experiment) -> None:
    run(experiment, view, steps=2)

    def number() -> str:
        found = [key for key, each in page.panel.items() if each.get("hint") == WEIGHT]
        return found[0] if found else ""

    while not number():
        page.read()
    for sent, expected in ((1e9, 10.0), (-1.0, 0.0), (float("nan"), None), (2.0, 2.0)):
        page._send("GuiUpdateMessage", uuid=number(), updates={"value": sent})
        wanted = {} if expected is None else {WEIGHT: expected}
        wait_until(
            lambda wanted=wanted: (
                {k: float(v) for k, v in view.requests().parameters.items()} == wanted
            )
        )


def test_nothing_is_printed_by_the_server(capfd) -> None:
    with warnings.catch_warnings():
        LiveView().close()
    assert capfd.readouterr() == ("", "")


def test_bytes_that_are_no_messages_print_nothing(capfd) -> None:
    """Random ones, and messages of viser with content that it does not expect."""
    view = LiveView()
    headers = {"subprotocols": [f"viser-v{viser.__version__}"], "max_size": None}
    odd = [
        bytes(np.random.default_rng(0).integers(0, 256, 300, np.uint8)),
        b"",
        "a text",
        msgspec.msgpack.encode([1, 2, 3]),
        msgspec.msgpack.encode({"type": "GuiUpdateMessage"}),
        msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": [1], "updates": 3}),
        msgspec.msgpack.encode({"type": "NoMessage"}),
    ]
    address = view.link.replace("http://", "ws://")
    for each in odd:
        with (
            connect(address, **headers) as page,
            contextlib.suppress(ConnectionClosed, TimeoutError),
        ):
            page.send(each)
            while True:
                page.recv(0.3)
    # It still serves pages.
    with connect(address, **headers) as page:
        assert page.recv(10.0)
    view.close()
    gc.collect()
    assert capfd.readouterr() == ("", "")
