"""What a run says of anomalies: found, missed, false alarms; in metrics, figure and film."""

import dataclasses

import numpy as np
import pytest

from jaxplore.maps.world import World
from jaxplore.parts.anomalies.report import AnomalyReport
from jaxplore.parts.anomalies.truth import find_anomalies
from jaxplore.report.drawing.colours import ALARM
from jaxplore.report.drawing.picture import WIDTH
from jaxplore.report.exploration.animation import frame_image
from jaxplore.report.exploration.canvas import make_canvas
from jaxplore.report.exploration.plots import map_figure
from jaxplore.report.recording_arrays import pack_recording, unpack_recording

BOXES = np.array([[0.5, 0.5, 1.0, 1.0], [2.0, 1.0, 2.4, 1.4], [1.4, 0.2, 1.6, 0.4]])
FOUND = AnomalyReport(
    boxes=BOXES,
    kinds=np.array([1, 2, 3]),
    # Of the first, once again of the first, beside all, of the second as something new, open.
    place=np.array([[0.9, 0.6], [0.5, 1.7], [2.9, 0.05], [2.2, 1.2], [1.5, 0.3]]),
    kind=np.array([1, 1, 2, 1, 3]),
    suspected=np.array([0.5, 1.0, 1.5, 0.2, 2.0]),
    reported=np.array([1.5, 2.0, 2.5, 2.25, np.inf]),
    num_cleared=4,
)


@pytest.fixture
def patrol(make_recording):
    run = make_recording([(0.5, 1.0), (1.0, 1.2), (1.5, 0.7)] * 2, [0.2] * 5)
    return dataclasses.replace(run, parts={"anomalies": FOUND})


def test_a_report_is_of_what_is_within_three_quarters_of_a_metre() -> None:
    expected = np.zeros((5, 3), bool)
    for row, (x, y) in enumerate(FOUND.place):
        for column, (left, low, right, high) in enumerate(BOXES):
            nearest = np.clip(x, left, right), np.clip(y, low, high)
            expected[row, column] = np.hypot(x - nearest[0], y - nearest[1]) <= 0.75
    np.testing.assert_array_equal(FOUND.matches, expected)
    # The second was reported as another kind, the third was only suspected.
    np.testing.assert_array_equal(FOUND.report_times, [1.5, np.inf, np.inf])


def test_metrics_tell_what_was_found_and_when(patrol) -> None:
    told = patrol.metrics()
    metrics = told.parts["anomalies"]
    assert (metrics.num_anomalies, metrics.anomalies_found) == (3, 1)
    assert (metrics.false_alarms, metrics.cleared) == (1, 4)
    assert metrics.last_anomaly_at is None
    assert [each["reported_at"] for each in metrics.reports] == [2.25, 1.5, 2.0, 2.5]
    assert [each["is_planted"] for each in metrics.reports] == [True, True, True, False]
    assert metrics.reports[0]["kind"] == "appeared"
    assert metrics.reports[0]["place"] == [2.2, 1.2]
    rows = dict(told.rows())
    assert rows["anomalies"] == "1 of 3 found; 1 false alarms, 4 suspicions dropped"
    assert rows["  gone"] == "(2.9, 0.1) m after 2.5 s, a false alarm"


def test_all_found_have_a_last_one(patrol) -> None:
    few = dataclasses.replace(FOUND, boxes=BOXES[:1], kinds=FOUND.kinds[:1])
    metrics = few.metrics(patrol)
    assert (metrics.anomalies_found, metrics.last_anomaly_at) == (1, 1.5)


def test_a_run_without_a_test_says_nothing_of_it(make_recording) -> None:
    metrics = make_recording([(0.5, 1.0), (1.0, 1.2)], [0.2]).metrics()
    assert metrics.parts == {}
    assert "anomalies" not in dict(metrics.rows())


def test_the_map_shows_what_was_found_and_what_was_not(patrol) -> None:
    (axes,) = [each for each in map_figure(patrol).axes if each.lines]
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    np.testing.assert_allclose(lines["anomaly found"], FOUND.middles[:1], atol=1e-5)
    np.testing.assert_allclose(lines["anomaly, not found"], FOUND.middles[1:], atol=1e-5)
    np.testing.assert_allclose(lines["report"], FOUND.place[:4], atol=1e-5)
    words = [text.get_text() for text in axes.texts]
    assert {"appeared, 2 s", "gone, 2 s"} <= set(words)


def test_a_frame_has_a_star_until_the_report_and_a_ring_after_it(patrol) -> None:
    height = make_canvas(patrol, WIDTH, 1.0).map.size[1]

    def marked(time: float) -> np.ndarray:
        frame = dataclasses.replace(patrol.frames[-1], time=time)
        picture = np.asarray(frame_image(patrol, frame), int)[:height]
        return np.abs(picture - ALARM).max(axis=-1) < 12

    before, after, later = (marked(time) for time in (1.4, 1.6, 2.4))
    assert before.any()
    assert (before != after).any()
    np.testing.assert_array_equal(after, later)


def test_a_stored_run_has_its_anomalies(patrol) -> None:
    again = unpack_recording(pack_recording(patrol))
    assert type(again.parts["anomalies"]) is AnomalyReport
    for name, value in vars(FOUND).items():
        np.testing.assert_array_equal(getattr(again.parts["anomalies"], name), value)


def test_planted_are_hidden_and_gone_shapes_and_who_is_where_nobody_may_be() -> None:
    world = World.from_dict(
        {
            "size": [8.0, 6.0],
            "start": [1.0, 1.0, 0.0],
            "wall_reach": 0.1,
            "walls": [[0.0, 0.0, 8.0, 0.0]],
            "hidden": {"rectangles": [[3.0, 3.0, 4.0, 3.5]], "walls": [[1.0, 5.0, 2.0, 4.0]]},
            "gone": {"discs": [[6.0, 1.5, 0.5]]},
            "forbidden": [[5.0, 3.0, 7.0, 5.0]],
            "movers": [
                {"path": [[2.0, 2.0], [3.0, 2.0]], "speed": 0.5, "radius": 0.2},
                {"path": [[4.5, 4.0], [6.0, 4.0]], "speed": 0.5, "radius": 0.2},
            ],
        }
    )
    planted = find_anomalies(world)
    assert planted.kinds.tolist() == [1, 1, 2, 3]
    expected = [(0.9, 3.9, 2.1, 5.1), (3.0, 3.0, 4.0, 3.5), (5.5, 1.0, 6.5, 2.0)]
    np.testing.assert_allclose(planted.boxes[:3], expected, atol=1e-6)
    np.testing.assert_allclose(planted.boxes[3], (4.8, 3.8, 6.2, 4.2), atol=0.06)
    prior, truth = (np.asarray(grid.probability) for grid in (world.prior(), world.truth()))
    assert (prior[32, 35], truth[32, 35]) == pytest.approx((0.01, 0.99))
    assert (prior[15, 60], truth[15, 60]) == pytest.approx((0.99, 0.01))
    assert World.from_dict(world.to_dict()) == world
