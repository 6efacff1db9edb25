"""A log whose odometry leads out of the map of surfaces."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.test_map_log_command import written_log

from jaxplore.cli import main
from jaxplore.localisation import log_mapping
from jaxplore.maps.frame import GridFrame

pytestmark = pytest.mark.long


def test_scans_that_leave_the_map_of_surfaces_are_matched_around_the_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As with an odometry that is wrong by more than the margin: the frame lies where it led."""
    whole = log_mapping.frame_around

    def elsewhere(*given: Any) -> tuple[GridFrame, tuple[int, int]]:
        frame, (height, width) = whole(*given)
        x, y, yaw = np.asarray(frame.origin, float).tolist()
        side = frame.resolution
        return GridFrame(side, (x + 0.5 * side * width, y - 0.4 * side * height, yaw)), (
            height,
            width,
        )

    monkeypatch.setattr(log_mapping, "frame_around", elsewhere)
    log, out = written_log(tmp_path / "ring.log", laps=2.5), tmp_path / "own"
    main(["map-log", str(log), "--resolution", "0.1", "--range", "10", "--out", str(out)])
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["estimated"]["ate"] < 0.06
    assert metrics["trust"]["warning"] == ""
