"""A node with a session that is killed in the middle and goes on, over real DDS; prints JSON.

Run by test_session.py in a process of its own, because ROS keeps threads and state in a process.
"""

import json
import os
import signal
import sys
from pathlib import Path

from field_program import PATIENCE, Watcher, command


def main(folder: Path) -> dict:
    office = ["--set", "office.width=14", "--set", "office.height=10", "--beams", "90"]
    session = folder / "session"
    node = [
        *("node", "--no-animation", "--session", str(session)),
        *("--set", "controller.num_samples=64", "--set", "node.map_size=30"),
        *("--set", "lidar.num_beams=90", "--set", "rates.control=20", "--set", "rates.sensing=10"),
        *("--set", "node.max_age=2", "--set", "node.max_frozen=5", "--set", "node.latency=0.1"),
        *("--set", "node.pose=internal", "--set", "localisation.loops=false"),
    ]
    robot = command(
        *("robot", "office", *office, "--out", str(folder / "robot"), "--time-limit", "900"),
        *("--no-animation", "--drift", "0.03", "--no-map"),
    )
    seen, drivers = {}, []
    try:
        watcher = Watcher()
        watcher.wait("the robot is there", lambda: watcher.robot)
        drivers.append(command(*node, "--out", str(folder / "first")))
        watcher.wait("it drives", lambda: watcher.driver.get("explored_m2", 0.0) > 25.0)
        watcher.order("save")
        watcher.wait("it is saved", lambda: watcher.driver.get("saved"))
        seen["before"] = [watcher.driver["explored_m2"], watcher.robot["coverage"]]
        drivers[0].kill()
        drivers[0].wait()
        watcher.wait("the watchdog stops it", lambda: max(watcher.speeds[-5:]) == 0.0)
        # Without other settings those of the session count.
        watcher.driver, watcher.reasons = {}, []
        drivers.append(command("node", "--no-animation", "--session", str(session),
                               "--out", str(folder / "second")))  # fmt: skip
        watcher.wait("it drives again", lambda: watcher.driver.get("mode") == "driving")
        seen["reasons"] = sorted(set(watcher.reasons))
        seen["after"] = [watcher.driver["explored_m2"], watcher.robot["coverage"]]
        grown = seen["after"][1] + 0.03
        watcher.wait("the map grows", lambda: watcher.robot["coverage"] > grown)
        # Another node does not get the folder.
        third = command("node", "--session", str(session), "--out", str(folder / "third"))
        text, _ = third.communicate(timeout=PATIENCE)
        seen["third"] = [third.returncode, text.strip().splitlines()[-1]]
        drivers[1].send_signal(signal.SIGINT)
        text, _ = drivers[1].communicate(timeout=PATIENCE)
        seen["second"] = [drivers[1].returncode, text[-2000:]]
        # Other settings are one line, and change nothing.
        kept = (session / "session.npz").read_bytes()
        other = command(*node, "--set", "node.map_size=20", "--out", str(folder / "other"))
        text, _ = other.communicate(timeout=PATIENCE)
        seen["other"] = [other.returncode, text.strip().splitlines()[-1]]
        seen["is_same"] = kept == (session / "session.npz").read_bytes()
        seen["end"] = [watcher.driver["explored_m2"], watcher.robot["coverage"]]
        seen["contacts"] = watcher.robot["contacts"]
    finally:
        for each in (robot, *drivers):
            each.kill()
    return seen


if __name__ == "__main__":
    print("SEEN " + json.dumps(main(Path(sys.argv[1]))), flush=True)
    # Threads of ROS need not be waited for.
    os._exit(0)
