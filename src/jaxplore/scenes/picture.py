"""The picture of a run of any other task in the browser: that of its animation."""

from typing import TYPE_CHECKING

import numpy as np

from jaxplore.report.recording import Frame, Recording
from jaxplore.scenes.scene import Scene

if TYPE_CHECKING:
    import viser

SIZE = 10.0
"""Longer side of the picture in the scene."""


class PictureScene(Scene):
    """The picture that a task draws of a frame, as in the animation."""

    layers = ("picture",)

    def __init__(self, server: "viser.ViserServer", recording: Recording) -> None:
        super().__init__(server)
        self.recording = recording
        self.look_at(0.5 * SIZE * np.array([[-1.0, -1.0], [1.0, 1.0]]))

    def draw(self, frame: Frame, trail: np.ndarray) -> None:
        """Draw a frame."""
        # Row 0 of a picture is its upper one.
        picture = np.asarray(self.recording.frame_image(frame).convert("RGB"))[::-1]
        rows, columns = picture.shape[:2]
        scale = SIZE / max(rows, columns)
        size = columns * scale, rows * scale
        corner = np.array([-0.5 * size[0], -0.5 * size[1], 0.0])
        self.picture("picture", picture, corner, size, 0.0)
