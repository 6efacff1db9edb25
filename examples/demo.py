"""The main job: a robot explores an unknown office and shows what it did.

Makes an office floor, writes it as a ROS map, and runs the command line on that file, as you would
on a map of your own.
"""

import sys
from pathlib import Path

import jaxplore as jx
from jaxplore.cli import main

FOLDER = Path("runs")

if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    world = jx.office(seed=0)
    world.to_ros(FOLDER / "office.yaml")
    x, y, yaw = jx.start_pose(world)
    arguments = ["run", str(FOLDER / "office.yaml"), "--start", f"{x}", f"{y}", f"{yaw}"]
    main([*arguments, "--out", str(FOLDER / "demo"), "--overwrite"])
    sys.stdout.write(f"\nLook at the pictures in {FOLDER / 'demo'}.\n")
