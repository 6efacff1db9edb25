"""What a run leaves behind: numbers, pictures, an animation, and the folder that holds them."""

from jaxplore.report.exploration.metrics import ExplorationMetrics as ExplorationMetrics
from jaxplore.report.exploration.recording import ExplorationRecording as ExplorationRecording
from jaxplore.report.following.metrics import PathMetrics as PathMetrics
from jaxplore.report.following.recording import PathRecording as PathRecording
from jaxplore.report.metrics import Metrics as Metrics
from jaxplore.report.recording import Recording as Recording
