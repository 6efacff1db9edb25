"""What a run says of objects and their classes: in metrics, tables, figure and film."""

import dataclasses

import numpy as np
import pytest

from jaxplore.parts.recognition.report import ObjectReport
from jaxplore.report.drawing.colours import ALARM, TARGET
from jaxplore.report.drawing.picture import WIDTH
from jaxplore.report.exploration.animation import frame_image
from jaxplore.report.exploration.canvas import make_canvas
from jaxplore.report.exploration.plots import map_figure
from jaxplore.report.recording_arrays import pack_recording, unpack_recording

NEVER = np.inf
# Two targets, a barrel that was reported as a person and then as what it is, and a door that was
# never detected.
OBJECTS = ObjectReport(
    classes=("door", "person", "barrel"),
    target=1,
    place=np.array([[0.6, 0.4], [1.4, 1.5], [2.2, 0.6], [2.6, 1.6]]),
    label=np.array([1, 1, 2, 0]),
    probability=np.array([[0.01, 0.98, 0.01], [0.2, 0.5, 0.3], [0.0, 0.03, 0.97], [1 / 3] * 3]),
    detected_at=np.array([0.5, 1.0, 0.5, NEVER]),
    looks=np.array([4, 1, 6, 0]),
    reported_at=np.array(
        [[NEVER, 1.0, NEVER], [NEVER] * 3, [NEVER, 1.5, 2.0], [NEVER] * 3],
    ),
    reported_probability=np.array([[0, 0.96, 0], [0] * 3, [0, 0.951, 0.97], [0] * 3]),
)


@pytest.fixture
def search(make_recording, make_search):
    run = make_recording([(0.5, 1.0), (1.0, 1.2), (1.5, 0.7)] * 2, [0.2] * 5)
    known = np.where(np.isfinite(OBJECTS.detected_at)[:, None], OBJECTS.probability, np.nan)
    is_found = np.array([True, False])
    frames = tuple(dataclasses.replace(each, parts=shown(known)) for each in run.frames)
    run = dataclasses.replace(run, frames=frames, parts={"detector": OBJECTS})
    return make_search(run, OBJECTS.place[:2], np.ones(5), lambda _: is_found, "recognised")


def shown(classes: np.ndarray) -> dict[str, dict[str, np.ndarray]]:
    return {"detector": {"classes": classes}, "targets": {"is_found": np.array([True, False])}}


def test_metrics_tell_what_was_reported_and_what_was_wrong(search) -> None:
    whole = search.metrics()
    metrics = whole.parts["detector"]
    assert (metrics.num_objects, metrics.objects_detected) == (4, 3)
    assert (metrics.false_reports, metrics.mislabelled) == (1, 0)
    wanted = -sum(p * np.log(p) for row in OBJECTS.probability for p in row if p > 0.0)
    assert metrics.class_entropy == pytest.approx(wanted)
    told = [(each["label"], each["reported_at"], each["is_true"]) for each in metrics.labels]
    assert told == [("person", 1.0, True), ("person", 1.5, False), ("barrel", 2.0, True)]
    rows = whole.rows()
    assert dict(rows)["targets"].endswith("recognised")
    found = "3 of 4 detected, 3 reports; 1 false reports of a target, 0 other mistakes"
    assert ("objects", found) in rows
    assert ("  person", "(0.6, 0.4) m after 1.0 s, 96 %") in rows
    assert ("  person", "(2.2, 0.6) m after 1.5 s, 95 %, but it is: barrel") in rows


def test_a_target_that_is_taken_for_something_else_is_a_mistake(search) -> None:
    reported = OBJECTS.reported_at.copy()
    reported[1, 0] = 2.5
    metrics = dataclasses.replace(OBJECTS, reported_at=reported).metrics(search)
    assert (metrics.false_reports, metrics.mislabelled) == (1, 1)


def test_a_run_without_a_detector_says_nothing_of_it(make_recording) -> None:
    metrics = make_recording([(0.5, 1.0), (1.0, 1.2)], [0.2]).metrics()
    assert metrics.parts == {}
    assert "objects" not in dict(metrics.rows())


def test_the_map_shows_what_each_object_is_taken_for(search) -> None:
    (axes,) = [each for each in map_figure(search).axes if each.lines]
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    np.testing.assert_allclose(lines["taken for: person"], OBJECTS.place[1:2], atol=1e-5)
    np.testing.assert_allclose(lines["taken for: barrel"], OBJECTS.place[2:3], atol=1e-5)
    np.testing.assert_allclose(lines["object, not detected"], OBJECTS.place[3:], atol=1e-5)
    words = [text.get_text() for text in axes.texts]
    assert {"person 50 %", "barrel 97 %, false report"} <= set(words)


def test_a_frame_has_badges_and_crosses_out_false_reports_from_then_on(search) -> None:
    height = make_canvas(search, WIDTH, 1.0).map.size[1]

    def drawn(time: float, **changes: object) -> np.ndarray:
        frame = dataclasses.replace(search.frames[-1], time=time, **changes)
        return np.asarray(frame_image(search, frame), int)[:height]

    def amount(picture: np.ndarray, colour) -> int:
        return int((np.abs(picture - colour) < 12).all(axis=-1).sum())

    before, after = drawn(1.4), drawn(1.6)
    assert amount(before, ALARM) == 0 < amount(after, ALARM)
    # The more certain, the more of the badge has the colour of the class.
    barrel = OBJECTS.class_colours[2]
    less = search.frames[-1].parts["detector"]["classes"].copy()
    less[2] = (0.3, 0.3, 0.4)
    full, part = (amount(each, barrel) for each in (before, drawn(1.4, parts=shown(less))))
    assert 0.25 * full < part < 0.6 * full
    # The target that was found has no badge, and one that was not detected neither.
    less = search.frames[-1].parts["detector"]["classes"].copy()
    less[0] = less[3] = np.nan
    np.testing.assert_array_equal(before, drawn(1.4, parts=shown(less)))


def test_classes_have_colours_of_their_own() -> None:
    colours = OBJECTS.class_colours
    assert colours[1] == TARGET
    assert len(set(colours)) == 3


def test_a_stored_run_has_its_objects(search) -> None:
    again = unpack_recording(pack_recording(search))
    for name, value in vars(OBJECTS).items():
        np.testing.assert_array_equal(getattr(again.parts["detector"], name), value)
    for one, other in zip(again.frames, search.frames, strict=True):
        np.testing.assert_array_equal(
            one.parts["detector"]["classes"], other.parts["detector"]["classes"]
        )
