"""Recorders: monitors that write a run to a file while it goes on."""

from jaxplore.recorder.recorder import McapRecorder as McapRecorder
from jaxplore.recorder.recorder import RecordingWarning as RecordingWarning
from jaxplore.recorder.switched import SwitchedRecorder as SwitchedRecorder
