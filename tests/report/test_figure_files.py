import numpy as np
import pytest
from PIL import Image

from jaxplore.report.drawing.figure import figure_bytes, figure_formats
from jaxplore.report.exploration.evaluation import compute_metrics
from jaxplore.report.exploration.plots import map_figure
from jaxplore.report.save import save_run

pytestmark = pytest.mark.long


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("png", ("png",)),
        ("pdf, SVG", ("pdf", "svg")),
        (["svg", "png", "svg"], ("svg", "png")),
    ],
)
def test_formats_are_a_text_or_a_sequence(given, expected):
    assert figure_formats(given) == expected


@pytest.mark.parametrize("given", ["jpg", "", "png,", [], ("pdf", "eps")])
def test_other_formats_are_refused(given):
    with pytest.raises(ValueError, match=r"figures is .*; accepted: one or more of png, pdf, svg"):
        figure_formats(given)


@pytest.mark.parametrize("kind", ["png", "pdf", "svg"])
def test_the_same_run_gives_the_same_file_without_date_or_version(recording, kind):
    one, other = (figure_bytes(map_figure(recording), kind) for _ in range(2))
    assert one == other
    for mark in (b"CreationDate", b"Matplotlib v", b"dc:date", b"matplotlib.org"):
        assert mark not in one


def test_texts_of_a_pdf_are_in_truetype(recording):
    data = figure_bytes(map_figure(recording), "pdf")
    assert b"/Type3" not in data
    assert b"/CIDFontType2" in data or b"/TrueType" in data


def test_a_folder_has_every_figure_in_every_format(recording, tmp_path):
    metrics = compute_metrics(recording)
    save_run(recording, metrics, tmp_path / "run", animation=False, figures="pdf,svg")
    names = {path.name for path in (tmp_path / "run").iterdir()}
    expected = {f"{name}.{kind}" for name in recording.figures() for kind in ("pdf", "svg")}
    assert names == expected | {
        "metrics.json",
        "arrays.npz",
        "state.npz",
        "explored.yaml",
        "explored.pgm",
    }
    with pytest.raises(ValueError, match="figures is 'gif'; accepted"):
        save_run(recording, metrics, tmp_path / "other", figures="gif")
    assert not (tmp_path / "other").exists()


def test_a_png_shows_what_the_figure_shows(recording, tmp_path):
    metrics = compute_metrics(recording)
    save_run(recording, metrics, tmp_path / "run", animation=False)
    with Image.open(tmp_path / "run" / "map.png") as image:
        saved = np.asarray(image.convert("RGB"))
    figure = map_figure(recording)
    figure.set_dpi(150)
    figure.canvas.draw()
    np.testing.assert_array_equal(saved, np.asarray(figure.canvas.buffer_rgba())[..., :3])
