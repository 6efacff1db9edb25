"""What is recorded of an exploration of a volume."""

import numpy as np

from jaxplore.report.drawing.palette import PLAN
from jaxplore.report.volume.data import VolumeFrame
from jaxplore.report.volume.space import surface
from jaxplore.topics import messages
from jaxplore.topics.content import MAP, Content


class VolumeContent(Content):
    """What is recorded of an exploration of a volume.

    Beside the commands, states and metrics these are the pose, the plan, and the voxels that the
    robot knows to be occupied, without the ceiling.
    """

    def write_scene(self, frame: VolumeFrame) -> None:
        """Write the pose and the plan."""
        names = self.recording.state_names
        x, y, z = (float(frame.state[names.index(name)]) for name in "xyz")
        turn = [names.index(name) for name in ("qw", "qx", "qy", "qz")]
        qw, qx, qy, qz = frame.state[turn].astype(np.float64).tolist()
        heading = float(np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz)))
        # The model has z down.
        self.log_pose(frame.time, np.array([x, y]), heading, -z)
        entities = {"plan": (MAP, {"lines": [messages.line(frame.plan, PLAN, 3.0)]})}
        update = messages.scene(self.channels.stamp(frame.time), entities)
        self.log("/plan", update, frame.time)

    def write_maps(self, frame: VolumeFrame) -> None:
        """Write the voxels."""
        run = self.recording
        voxels = surface(frame.find_occupied(run.world.shape))
        points = run.origin + (voxels[:, ::-1] + 0.5) * run.resolution
        stamp = self.channels.stamp(frame.time)
        self.log("/voxels", messages.point_cloud(stamp, MAP, points), frame.time)
