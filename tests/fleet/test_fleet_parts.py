"""Robots that are divided among workers of a cluster run as in one process, and end together."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from jaxplore.control.fleet_share import Share
from jaxplore.simulation.fleet.scenario import Fleet

pytestmark = pytest.mark.long

PROGRAM = Path(__file__).with_name("parts_program.py")


def said(what: str):
    """Return what the program prints; in a process of its own, for Ray has threads that stay."""
    pytest.importorskip("ray")
    done = subprocess.run(
        [sys.executable, str(PROGRAM), what],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ},
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_two_workers_run_as_one_process_to_the_bit() -> None:
    """Through two exchanges of maps: every record, the maps of both at the end, and the frames."""
    found = said("same")
    assert found["steps"] == 40
    assert found["sent"] > 1000.0
    assert found["moved"] > 0.3
    assert set(found["gaps"].values()) == {0.0}


@pytest.mark.skipif(sys.platform != "linux", reason="reads processes from /proc")
def test_a_dead_worker_and_an_interrupt_end_all() -> None:
    (killed, left), (stopped, more) = said("ends")
    assert killed.startswith("worker 1 of 2 of the fleet ended: ")
    assert "\n" not in killed
    assert stopped == "interrupted"
    assert left == more == 0


def test_a_share_puts_the_robots_of_all_in_their_order() -> None:
    """With a meeting in this process, at which the other one tells more."""

    def meet(mine):
        return [np.concatenate([each, each + 10]) for each in mine]

    share = Share((0, 1), 4, meet)
    assert share.select("abcd") == ("a", "b")
    found = share.gather(
        [(np.float32(1.0), np.ones(2, np.int32)), (np.float32(2.0), np.zeros(2, np.int32))]
    )
    np.testing.assert_array_equal([each[0] for each in found], [1.0, 2.0, 11.0, 12.0])
    np.testing.assert_array_equal([each[1][0] for each in found], [1, 0, 11, 10])
    here = share.gather_on_host([np.zeros(3), np.ones(3)])
    np.testing.assert_array_equal(here, np.array([0, 1, 10, 11])[:, None] * np.ones(3))
    rows = ["own"]
    assert Share.whole(1).gather(rows) == rows


def test_robots_that_cannot_be_divided_are_named(alone, fleet) -> None:
    def meet(mine):
        return mine

    single = Fleet(alone)
    with pytest.raises(ValueError, match="robots are 1 of 1 kinds; accepted in several processes"):
        single.with_share(Share((0,), 1, meet))
    controller, two = fleet()
    part = Share((0,), 2, meet)
    assert two.with_share(part).share is part
    assert controller.with_share(part).share is part


def test_settings_of_workers_that_do_not_fit_get_one_line(fails) -> None:
    line = fails("run", "fleet", "--robots", "2", "--set", "fleet.workers=3")
    assert "fleet.workers is 3 for 2 robots; accepted: at most one for each" in line
    line = fails("run", "fleet", "--set", "fleet.workers=2", "--record", "run.mcap")
    assert "fleet.workers is 2 beside --record; accepted: 1" in line
    assert "fleet.workers is 2 beside --view" in fails(
        "run", "fleet", "--set", "fleet.workers=2", "--view"
    )
