"""Files of figures: PNG, PDF and SVG, the same file for the same figure."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PNG = "png"
FORMATS = (PNG, "pdf", "svg")
DOTS_PER_INCH, IMAGE_DOTS_PER_INCH = 150, 300
"""Resolution of a PNG, and of the images within a PDF or an SVG."""
_METADATA: dict[str, dict[str, Any]] = {
    PNG: {"Software": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "svg": {"Date": None, "Creator": None},
}
"""Entries without which a file holds neither its date nor the version of Matplotlib."""


def figure_formats(figures: str | Sequence[str]) -> tuple[str, ...]:
    """Return the formats of figures, given as a sequence or as a text with commas."""
    names = figures.split(",") if isinstance(figures, str) else figures
    if not isinstance(names, Sequence):
        names = ()
    found = tuple(dict.fromkeys(str(name).strip().lower() for name in names))
    if not found or not set(found) <= set(FORMATS):
        raise ValueError(f"figures is {figures!r}; accepted: one or more of {', '.join(FORMATS)}")
    return found


def figure_bytes(figure: "Figure", kind: str = PNG, dpi: int | float | None = None) -> bytes:
    """Return the file of a figure as png, pdf or svg.

    `dpi` is the resolution of a PNG, or of the images within the others; None takes the default
    of the format.
    """
    import matplotlib as mpl

    if dpi is None:
        dpi = DOTS_PER_INCH if kind == PNG else IMAGE_DOTS_PER_INCH
    # Journals ask for TrueType fonts. Without a salt the names within an SVG are random.
    with mpl.rc_context({"pdf.fonttype": 42, "svg.hashsalt": "jaxplore"}):
        file = io.BytesIO()
        figure.savefig(file, format=kind, dpi=dpi, metadata=_METADATA[kind])
    return file.getvalue()


def write_figure(figure: "Figure", folder: Path, name: str, kinds: Sequence[str]) -> None:
    """Write a figure into an existing folder in each of the formats; `name` has no suffix."""
    for kind in kinds:
        (folder / f"{name}.{kind}").write_bytes(figure_bytes(figure, kind))
