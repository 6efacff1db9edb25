"""Metrics, figures and animation of a run, and the run folder that holds them."""

from jaxplore.report.drawing.film import Film as Film
from jaxplore.report.drawing.film import FilmOptions as FilmOptions
from jaxplore.report.exploration.metrics import ExplorationMetrics as ExplorationMetrics
from jaxplore.report.exploration.recording import ExplorationRecording as ExplorationRecording
from jaxplore.report.following.metrics import PathMetrics as PathMetrics
from jaxplore.report.following.recording import PathRecording as PathRecording
from jaxplore.report.metrics import Column as Column
from jaxplore.report.metrics import Curve as Curve
from jaxplore.report.metrics import Metrics as Metrics
from jaxplore.report.metrics import sampled_series as sampled_series
from jaxplore.report.recording import Frame as Frame
from jaxplore.report.recording import Recording as Recording
