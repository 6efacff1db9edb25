"""Metrics, figures and animation of a run, and the run folder that holds them."""

from jaxplore.report.drawing.film import Film as Film
from jaxplore.report.drawing.film import FilmOptions as FilmOptions
from jaxplore.report.exploration.metrics import ExplorationMetrics as ExplorationMetrics
from jaxplore.report.exploration.recording import ExplorationRecording as ExplorationRecording
from jaxplore.report.following.metrics import PathMetrics as PathMetrics
from jaxplore.report.following.recording import PathRecording as PathRecording
from jaxplore.report.localisation import AbsoluteError as AbsoluteError
from jaxplore.report.localisation import Alignment as Alignment
from jaxplore.report.localisation import MapAgreement as MapAgreement
from jaxplore.report.localisation import RelativeError as RelativeError
from jaxplore.report.localisation import absolute_error as absolute_error
from jaxplore.report.localisation import align as align
from jaxplore.report.localisation import aligned_coverage as aligned_coverage
from jaxplore.report.localisation import map_agreement as map_agreement
from jaxplore.report.localisation import relative_error as relative_error
from jaxplore.report.metrics import Column as Column
from jaxplore.report.metrics import Curve as Curve
from jaxplore.report.metrics import Metrics as Metrics
from jaxplore.report.metrics import thin_series as thin_series
from jaxplore.report.part import PartMetrics as PartMetrics
from jaxplore.report.part import PartReport as PartReport
from jaxplore.report.recording import Frame as Frame
from jaxplore.report.recording import LiveCurves as LiveCurves
from jaxplore.report.recording import Recording as Recording
