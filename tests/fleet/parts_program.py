"""Two robots in one process and in two workers of a cluster, which die or are stopped."""

import atexit
import json
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path

import jax
import numpy as np

import jaxplore as jx
from jaxplore.control.fleet_controller import same_for_all
from jaxplore.costs.moving import MovingObstacleCost
from jaxplore.simulation.run import simulate
from jaxplore.study.fleet_parts import simulate_in_parts

STEPS = 40
FOLDER = tempfile.mkdtemp()
"""Where each worker writes its process, by the place of its first robot."""


class Noted(jx.Fleet):
    """A fleet whose parts note the processes that they run in."""

    def with_share(self, share):
        Path(FOLDER, str(share.mine[0])).write_text(str(os.getpid()))
        return super().with_share(share)


def two_robots():
    """Return controller and fleet of two small robots in a room with a wall."""
    world = np.zeros((30, 40), np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 1.0, 1.0, 1.0, 1.0
    world[8:22, 20] = 1.0
    robot = jx.DifferentialDrive(max_speed=1.0, radius=0.15)
    lidar = jx.Lidar(num_beams=36, max_range=1.5, range_noise=0.01)
    watch = [jx.parts.IdlenessMap(20.0)]
    numbers = {"num_directions": 4, "max_clearance": 0.5, "parts": watch}
    perception = jx.Perception(lidar, 0.1, 0.15, **numbers)
    alone = jx.ExplorationScenario(
        jx.OccupancyGrid(world, 0.1),
        robot,
        lidar,
        (1.0, 1.0, 0.3),
        perception=perception,
        control_rate=20.0,
        field_rate=4.0,
        truths=[jx.parts.Targets([(1.9, 1.5), (3.5, 0.5)])],
    ).with_guard(jx.MotionGuard())
    fleet = Noted(alone, [(1.0, 1.0, 0.3), (1.0, 2.0, -0.4)], plan_length=10)
    drive = jx.explorer(
        robot,
        has_moving_obstacles=True,
        moving_obstacle_cost=MovingObstacleCost(nearness=None, clearance=0.6),
        horizon=10,
        num_samples=32,
    )
    return same_for_all(drive, fleet.robot), fleet


def workers():
    """Return the processes of actors that descend from this process."""
    parents, names = {}, {}
    for each in Path("/proc").glob("[0-9]*/stat"):
        try:
            name, _, rest = each.read_text().partition("(")[2].rpartition(")")
            parents[int(each.parent.name)] = int(rest.split()[1])
            names[int(each.parent.name)] = name
        except OSError:
            continue  # it has ended
    found = {os.getpid()}
    while more := {each for each, parent in parents.items() if parent in found} - found:
        found |= more
    return sorted(each for each in found if names.get(each, "").startswith("ray::_Worker"))


def once_they_run(act):
    """Call a function in a thread, a while after both workers have noted their processes."""

    def wait():
        deadline = time.monotonic() + 120.0
        while time.monotonic() < deadline:
            noted = {int(each.read_text() or 0) for each in Path(FOLDER).iterdir()}
            if len(noted) == 2 and noted == set(workers()):
                time.sleep(2.0)
                act()
                return
            time.sleep(0.2)

    threading.Thread(target=wait, daemon=True).start()


def ends(act):
    """Return how a run ends in which something happens, and whether workers are left."""
    once_they_run(act)
    try:
        simulate_in_parts(controller, fleet, 100_000, workers=2, **options)
    except ChildProcessError as error:
        said = str(error)
    except KeyboardInterrupt:
        said = "interrupted"
    deadline = time.monotonic() + 20.0
    while workers() and time.monotonic() < deadline:
        time.sleep(0.2)
    return [said, len(workers())]


if __name__ == "__main__":
    # A shell ignores the signal for what it runs in the background.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    atexit.register(shutil.rmtree, FOLDER, ignore_errors=True)
    controller, fleet = two_robots()
    options = {"key": jax.random.key(3), "num_trajectories": 0}
    if sys.argv[1] == "ends":
        # The numbers of processes are in no order.
        killed = ends(lambda: os.kill(int(Path(FOLDER, "0").read_text()), signal.SIGKILL))
        stopped = ends(lambda: os.kill(os.getpid(), signal.SIGINT))
        print(json.dumps([killed, stopped]))
        sys.exit()
    one = simulate(controller, fleet, STEPS, **options).recording
    parts = simulate_in_parts(controller, fleet, STEPS, workers=2, **options).recording
    gaps = {
        name: float(
            np.abs(
                np.asarray(getattr(one.records, name), np.float64)
                - np.asarray(getattr(parts.records, name), np.float64)
            ).max()
        )
        for name in one.records._fields
        # Robots without a guard or an estimate have no field of it.
        if name != "parts" and getattr(one.records, name) is not None
    }
    records = (each.records.parts["watch"] for each in (one, parts))
    for name, rows in zip(("mean", "worst"), zip(*records, strict=True), strict=True):
        gaps[name] = float(np.abs(np.subtract(*rows, dtype=np.float64)).max())
    idle = [each.parts["watch"].idleness for each in (one, parts)]
    gaps["idleness"] = float(np.abs(np.nan_to_num(idle[0] - idle[1])).max())
    gaps["never seen"] = float((np.isinf(idle[0]) != np.isinf(idle[1])).any())
    teams = [each.records.parts["team"]._asdict() for each in (one, parts)]
    for name in teams[0]:
        rows = [np.asarray(each[name], np.float64) for each in teams]
        gaps[f"team {name}"] = float(np.abs(np.subtract(*rows)).max())
    beliefs = [each.parts["team"].beliefs.astype(int) for each in (one, parts)]
    gaps["beliefs"] = float(np.abs(beliefs[0] - beliefs[1]).max())
    gaps["frames"] = float(
        np.abs(one.frames[-1].probability.astype(int) - parts.frames[-1].probability).max()
    )
    sent = float(parts.records.parts["team"].sent.sum())
    moved = float(np.ptp(parts.records.state, axis=0).max())
    print(json.dumps({"gaps": gaps, "sent": sent, "moved": moved, "steps": parts.num_steps}))
