"""A live view in headless Chromium, which is driven through the Chrome DevTools protocol."""

import base64
import io
import itertools
import json
import shutil
import subprocess
import threading
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from PIL import Image
from websockets.sync.client import connect

from jaxplore import simulate
from jaxplore.recorder import SwitchedRecorder
from jaxplore.report.drawing.colours import UNKNOWN
from jaxplore.report.drawing.palette import ROBOT
from jaxplore.report.drawing.rollout_costs import COST_COLOURS
from jaxplore.view import LiveView

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(
        shutil.which("chromium") is None, reason="no Chromium: apt-get install chromium"
    ),
]
KEY = jax.random.key(3)

DRAWN = 0.3
"""Time between two looks at the canvas, each of which the processor draws anew [s]."""
PATIENCE = 60.0
"""Time after which a test that waits has failed [s]: no test passes because of a duration."""


def wait_until(is_true: Callable[[], Any], what: str, pause: float = 0.02) -> Any:
    """Wait until a function returns something true, and return that."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if found := is_true():
            return found
        time.sleep(pause)
    raise AssertionError(f"waited in vain: {what}")


class Browser:
    """A browser without a window, with a profile of its own.

    Args:
        profile: folder of the profile, which is empty.
        size: width and height of the window [pixels].
    """

    def __init__(self, profile: Path, size: tuple[int, int] = (960, 600)) -> None:
        # WebGL is computed by the processor.
        self._process = subprocess.Popen(
            [
                "chromium",
                "--headless",
                "--no-sandbox",
                "--use-gl=angle",
                "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader",
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-quic",
                "--disable-sync",
                "--no-first-run",
                "--remote-debugging-port=0",
                f"--window-size={size[0]},{size[1]}",
                f"--user-data-dir={profile}",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        told = profile / "DevToolsActivePort"
        wait_until(lambda: told.exists() and "\n" in told.read_text(), "Chromium's port")
        self._port = told.read_text().split()[0]

    def open(self, address: str) -> "Page":
        """Open a page in a tab of its own."""
        url = f"http://127.0.0.1:{self._port}/json/new?about:blank"
        with urllib.request.urlopen(urllib.request.Request(url, method="PUT")) as answer:
            tab = json.load(answer)
        page = Page(tab["webSocketDebuggerUrl"])
        page.tell("Page.enable")
        page.tell("Page.navigate", url=address)
        return page

    def close(self) -> None:
        """End the browser."""
        self._process.terminate()
        self._process.wait(timeout=PATIENCE)


class Page:
    """A tab of a browser.

    Args:
        address: WebSocket of the tab.
    """

    def __init__(self, address: str) -> None:
        self._socket = connect(address, max_size=2**26)
        self._numbers = itertools.count(1)

    def tell(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and return its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=PATIENCE))
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]

    def value(self, expression: str) -> Any:
        """Return the value of a JavaScript expression."""
        result = self.tell("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def wait_for(self, expression: str) -> Any:
        """Wait until a JavaScript expression is true, and return its value."""
        return wait_until(lambda: self.value(expression), expression)

    def click(self, x: float, y: float) -> None:
        """Press and release the left button of the mouse at a point of the page [pixels]."""
        for kind in ("mousePressed", "mouseReleased"):
            self.tell("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def click_on(self, element: str) -> None:
        """Click into the middle of the element of a JavaScript expression."""
        box = f"({element}).getBoundingClientRect()"
        x, y = self.value(f"[{box}.x + {box}.width / 2, {box}.y + {box}.height / 2]")
        self.click(x, y)

    def picture(self) -> bytes:
        """Return a PNG of the page."""
        return base64.b64decode(self.tell("Page.captureScreenshot", format="png")["data"])

    def close(self) -> None:
        """Close the tab."""
        self.tell("Page.close")
        self._socket.close()


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


class Watched(LiveView):
    """A view that notes which parameters the run was asked for, and how far it is.

    The run waits after a number of steps, which leaves the processor to the browser.
    """

    def __init__(self) -> None:
        super().__init__(recorder=SwitchedRecorder())
        self.steps, self.allowed, self.asked = 0, 20, {}

    def show(self, update) -> None:
        super().show(update)
        self.steps = update.frame.step

    def requests(self):
        requests = super().requests()
        self.asked = {name: float(value) for name, value in requests.parameters.items()}
        return requests._replace(is_paused=self.steps >= self.allowed)


def element(kind: str, text: str) -> str:
    """Return an expression for the element of a kind that holds nothing but a text."""
    return (
        f"[...document.querySelectorAll('{kind}')]"
        f".find(each => each.textContent.trim() === '{text}')"
    )


SLIDER = "[...document.querySelectorAll('[role=slider]')].find(each => each.offsetParent)"
"""The first slider that is seen."""


def test_a_page_shows_a_run_drives_its_sliders_and_is_closed(browser, make) -> None:
    # The same programs as those of the other files; compiled here, where nobody is impatient.
    controller, scenario = make()
    simulate(controller, scenario, 1, key=KEY, num_trajectories=8)
    view, result = Watched(), []

    def run() -> None:
        result.append(
            simulate(controller, scenario, 10**6, key=KEY, num_trajectories=8, monitors=[view])
        )

    thread = threading.Thread(target=run)
    thread.start()
    # Nothing is compiled any more, and nothing changes, while the browser draws.
    wait_until(lambda: view.steps >= view.allowed, "a pause")
    page = browser.open(view.link)
    try:
        wait_until(lambda: view.num_pages == 1, "a page")
        page.wait_for("!!document.querySelector('canvas')")
        # What nobody has seen, and the robot on it, in their colours.
        wait_until(lambda: {UNKNOWN, ROBOT} <= colours(page), "a map with a robot", DRAWN)
        before = canvas(page)
        wait_until(lambda: is_chosen(page, "weight", "total cost"), "a choice", DRAWN)
        page.wait_for(f"document.body.innerHTML.includes('rgb{COST_COLOURS[0]}')")
        wait_until(lambda: (canvas(page) != before).any(), "rollouts coloured by cost", DRAWN)
        page.wait_for(f"!!({element('button', 'Record')})")
        page.click_on(element("[role=tab]", "Parameters"))
        page.wait_for(f"!!({SLIDER})")
        low, high = (float(page.value(f"({SLIDER}).ariaValue{each}")) for each in ("Min", "Max"))
        page.value(f"({SLIDER}).focus()")
        before = float(page.value(f"({SLIDER}).ariaValueNow"))
        for _ in range(3):
            press(page, "ArrowLeft")
        page.wait_for(f"Number(({SLIDER}).ariaValueNow) < {before}")
        (moved,) = wait_until(lambda: view.asked.values(), "a parameter")
        shown = float(page.value(f"({SLIDER}).ariaValueNow"))
        assert low <= shown < before <= high
        wait_until(lambda: list(view.asked.values()) == [pytest.approx(shown)], "its value")
        assert moved < before
        # The run goes on without the page.
        page.close()
        wait_until(lambda: view.num_pages == 0, "no page")
        done = view.steps
        view.allowed = 2 * done
        wait_until(lambda: view.steps > done, "further steps")
        assert thread.is_alive()
    finally:
        view._is_stopped = True
        thread.join()
        view.close()
    (ended,) = result
    (path,) = ended.parameters
    assert path == "dynamics.max_speed"
    assert ended.parameters[path] == pytest.approx(shown)


def is_chosen(page: Page, before: str, after: str) -> bool:
    """Choose an entry of a list in place of another, and return whether it is chosen.

    The list moves while it opens, so a click may miss.
    """

    def chosen(value: str) -> str:
        return f"[...document.querySelectorAll('input')].find(each => each.value === '{value}')"

    entry = element("[role=option]", after)
    if page.value(f"!!({entry}) && !!({entry}).offsetParent"):
        page.click_on(entry)
    elif page.value(f"!!{chosen(before)}"):
        page.click_on(chosen(before))
    return bool(page.value(f"!!{chosen(after)}"))


def press(page: Page, key: str) -> None:
    """Press and release a key."""
    for kind in ("keyDown", "keyUp"):
        page.tell("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=37)


def canvas(page: Page) -> np.ndarray:
    """Return a picture (rows, columns, 3) of the half of the page that has no panel."""
    picture = np.asarray(Image.open(io.BytesIO(page.picture())).convert("RGB")).astype(int)
    return picture[:, : picture.shape[1] // 2]


def colours(page: Page) -> set[tuple[int, int, int]]:
    """Return the colours of belief and robot that the canvas shows, within what light changes."""
    picture, found = canvas(page), set()
    for colour in (UNKNOWN, ROBOT):
        share = picture / np.maximum(np.linalg.norm(picture, axis=-1, keepdims=True), 1.0)
        wanted = np.array(colour) / np.linalg.norm(colour)
        # The robot is lit: its hue stays, its brightness does not.
        is_like = (share @ wanted > 0.995) & (picture.max(axis=-1) < 235)
        if is_like.sum() >= 10:
            found.add(colour)
    return found
