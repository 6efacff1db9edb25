"""The protocol of what a run shows of a part of its robots: metrics, figures, films, files."""

import abc
import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from PIL import ImageDraw

from jaxplore.report.drawing.footer import Entry
from jaxplore.report.drawing.palette import Colour
from jaxplore.report.drawing.shapes import Surface
from jaxplore.report.exploration.window import Window
from jaxplore.report.metrics import Column, Curve

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True, kw_only=True)
class PartMetrics:
    """Metrics of a part; in `metrics.json` they are under its name."""

    columns: ClassVar[tuple[Column, ...]] = ()
    """Columns of a comparison's table, computed from the metrics of the part."""
    plotted: ClassVar[tuple[Curve, ...]] = ()
    """Curves of a comparison, each a key of `PartReport.series`; `applies` is asked of these."""
    is_end: ClassVar[bool] = False
    """Whether the part says when the task is finished."""

    def rows(self) -> list[tuple[str, str]]:
        """Return the main metrics as (name, text), for tables."""
        return []


class Headline(NamedTuple):
    """The number that a film shows below its picture: its text at a step, what it is, its values (N
    + 1,) at all instants, and the upper end of their curve, by default the greatest."""

    text: str
    label: str
    values: np.ndarray
    most: float | None = None


class Tally(NamedTuple):
    """How many of some things were found at all instants (N + 1,), of how many, and their
    colour."""

    label: str
    values: np.ndarray
    number: int
    colour: tuple[int, int, int]


class PartReport(abc.ABC):
    """What a run shows of a part, in NumPy; a frozen dataclass.

    All methods but `metrics` show nothing by default. `run` are the data of the run that have the
    report, and `frame` is a frame of them. Pictures of a volume show `marks` and `footer`, and call
    `add_to_space` in place of `add_to_map` and `draw`.
    """

    name: ClassVar[str]
    """Name of the part."""
    record_type: ClassVar[type | None] = None
    """Class of its record of a step, a NamedTuple; None without one."""
    mark_size: ClassVar[float] = 0.6
    """Radius of the discs of `marks` in the browser, as a multiple of the robot's."""

    def move(self, offset: np.ndarray) -> "PartReport":
        """Return the report with an offset (2,) [m] added to all positions."""
        return self

    @abc.abstractmethod
    def metrics(self, run: Any) -> PartMetrics:
        """Compute the metrics of the part."""

    def series(self, run: Any) -> dict[str, np.ndarray]:
        """Return quantities at the N + 1 instants of a run, by name."""
        return {}

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what `arrays.npz` has of the part, beside its fields of the record."""
        return {}

    def figures(self, run: Any) -> dict[str, Callable[[], "Figure"]]:
        """Return functions that draw figures, by file name without suffix."""
        return {}

    def tally(self, run: Any) -> Tally | None:
        """Return how many of what the task is about were found.

        It is in the title of the map, below the coverage, and in the curves of a view.
        """
        return None

    def headline(self, run: Any, step: int) -> Headline | None:
        """Return what a film of a run on a known map shows after a number of steps."""
        return None

    def add_to_map(self, axes: "Axes", run: Any, window: Window) -> None:  # noqa: B027
        """Draw into the figure of the map."""

    def add_to_space(self, axes: "Axes", frame: Any) -> None:  # noqa: B027
        """Draw into the figure of a volume, which has three dimensions."""

    def draw(  # noqa: B027
        self, surface: Surface, draw: ImageDraw.ImageDraw, run: Any, frame: Any
    ) -> None:
        """Draw into a picture of the film."""

    def footer(self, run: Any, frame: Any) -> str:
        """Return a few words below the picture of a frame."""
        return ""

    def marks(self, frame: Any) -> list[tuple[np.ndarray, Colour]]:
        """Return the place (2,), in a volume (3,) [m], and colour of each disc that views show in a
        frame."""
        return []

    def legend(self) -> list[Entry]:
        """Return what the legend of the film says."""
        return []

    def colours(self) -> list[Colour]:
        """Return the colours that the film needs."""
        return []
