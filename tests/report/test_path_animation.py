import dataclasses

import numpy as np
import pytest
from PIL import Image

from jaxplore.report.drawing.colours import FREE, MISSED, MOVER_EDGE, blend
from jaxplore.report.drawing.film import CAPTION, FilmOptions
from jaxplore.report.drawing.footer import footer_height
from jaxplore.report.drawing.palette import PLAN, ROBOT, STRONG, TRAIL
from jaxplore.report.following.animation import BEYOND, path_frame_image
from jaxplore.report.following.plots import course_box

FOOTER = footer_height(600.0, 8)
"""Height of a footer with two lines of entries [pixels]."""


def near(image, colour) -> np.ndarray:
    return np.abs(np.asarray(image).astype(int)[:-FOOTER] - colour).max(axis=-1) < 3


def spots(run, image, colour) -> np.ndarray:
    """(x, y) [m] of what has a colour in the map, the long side of which is 600 pixels."""
    low, high = course_box(run)
    scale = 600.0 / (high - low).max()
    rows, columns = np.nonzero(near(image, colour))
    return np.stack([low[0] + (columns + 0.5) / scale, high[1] - (rows + 0.5) / scale], axis=-1)


def at(run, image, point) -> tuple[int, ...]:
    low, high = course_box(run)
    x, y = (np.array([point[0] - low[0], high[1] - point[1]]) * 600.0 / (high - low).max()).tolist()
    return image.getpixel((int(x), int(y)))


def bare(frame, **changes):
    """Without rollouts and plan, which may lie over what is looked for."""
    return dataclasses.replace(
        frame, samples=frame.samples[:0], weights=frame.weights[:0], plan=frame.plan[:0], **changes
    )


def test_many_frames_are_as_many_pictures(make_ring, tmp_path):
    run = make_ring(steps=20, num_frames=41)
    for most, count in ((240, 41), (10, 10), (1, 1)):
        run.write_animation(tmp_path / "run.gif", FilmOptions(max_frames=most, scale=0.5))
        with Image.open(tmp_path / "run.gif") as image:
            assert getattr(image, "n_frames", 1) == count


def test_the_same_run_gives_the_same_file(make_ring, tmp_path):
    for name in ("one.gif", "other.gif"):
        make_ring().write_animation(tmp_path / name)
    assert (tmp_path / "one.gif").read_bytes() == (tmp_path / "other.gif").read_bytes()


def test_a_run_without_a_step(path_start, tmp_path):
    path_start.write_animation(tmp_path / "run.gif")
    with Image.open(tmp_path / "run.gif") as image:
        assert getattr(image, "n_frames", 1) == 1


def test_looks_without_rollouts(ring, tmp_path):
    frames = tuple(bare(frame) for frame in ring.frames)
    dataclasses.replace(ring, frames=frames).write_animation(tmp_path / "run.gif")


@pytest.mark.parametrize("size", [(10.0, 0.0), (0.0, 10.0), (3000.0, 20.0), (0.01, 0.02), (1, 1)])
def test_any_course_fits(make_straight, size):
    run = make_straight()
    centre = np.linspace(0.0, 1.0, 21)[:, None] * np.asarray(size, float)
    for each in (run, dataclasses.replace(run, robot_radius=0.0)):
        state = each.records.state.copy()
        state[:, :2] = centre[1:11]
        each = dataclasses.replace(
            each,
            records=each.records._replace(state=state),
            start=np.concatenate([centre[0], each.start[2:]]).astype(np.float32),
            centre=centre,
            length=float(np.hypot(*size)),
        )
        image = path_frame_image(each, each.frames[-1])
        assert 320 <= image.width <= 720
        assert 100 < image.height <= 720 + footer_height(320.0, 5)


def test_the_ground_is_bright_in_the_corridor(ring):
    image = path_frame_image(ring, bare(ring.frames[0]), side=600)
    assert at(ring, image, (-3.3, -3.3)) == FREE
    assert at(ring, image, (0.0, 0.0)) == BEYOND
    assert at(ring, image, (-5.9, 5.9)) == BEYOND


def test_without_bounds_all_of_the_ground_is_free(ring, straight):
    edges = ring.edges.copy()
    edges[0, 5:9] = np.inf
    open_ring = dataclasses.replace(ring, edges=edges)
    for run in (open_ring, straight):
        image = path_frame_image(run, bare(run.frames[0]), side=600)
        assert not near(image, BEYOND).any()
        assert near(image, FREE).mean() > 0.9


def test_the_robot_is_drawn_where_it_stands_as_it_heads(ring):
    image = path_frame_image(ring, bare(ring.frames[0]), side=600)
    car = spots(ring, image, ROBOT)
    # At (5, 0) along y, 0.4 m of it ahead and 0.2 m behind, less its white edge.
    np.testing.assert_allclose(car.min(axis=0), [4.85, -0.2], atol=0.06)
    np.testing.assert_allclose(car.max(axis=0), [5.15, 0.4], atol=0.06)


def test_obstacles_are_drawn_where_they_are(ring):
    image = path_frame_image(ring, bare(ring.frames[1]), side=600)
    edge = spots(ring, image, MOVER_EDGE)
    x = float(ring.frames[1].corners[0, 0, 0])
    expected = [(x, 4.8, 0.3, 0.3), (-5.0, 0.0, 0.3, 0.3), (0.0, -5.0, 0.65, 0.15)]
    for middle_x, middle_y, half_width, half_height in expected:
        middle, half = np.array([middle_x, middle_y]), np.array([half_width, half_height])
        here = edge[(np.abs(edge - middle) < half + 0.1).all(axis=1)]
        np.testing.assert_allclose(here.min(axis=0), middle - half, atol=0.05)
        np.testing.assert_allclose(here.max(axis=0), middle + half, atol=0.05)
    assert len(edge) == sum(
        (np.abs(edge - [x, y]) < [width + 0.1, height + 0.1]).all(axis=1).sum()
        for x, y, width, height in expected
    )


def test_only_what_was_is_drawn(ring):
    first, last = (
        path_frame_image(ring, bare(frame), side=600) for frame in (ring.frames[0], ring.frames[-1])
    )
    assert not near(first, TRAIL).any()
    assert not near(first, MISSED).any()
    assert near(last, TRAIL).sum() > 300
    wrong = spots(ring, last, MISSED)
    for step in (4, 5, 7, 12):
        assert np.hypot(*(wrong - ring.positions[step + 1]).T).min() < 0.1
    for step in (2, 10, 15, 20):
        assert np.hypot(*(wrong - ring.positions[step + 1]).T).min() > 0.5


def test_plan_and_rollouts_lead_ahead(straight):
    frame = straight.frames[1]
    image = path_frame_image(straight, frame, side=600)
    plan, heavy = (
        spots(straight, image, colour) for colour in (PLAN, blend(STRONG, FREE, STRONG[3] / 255))
    )
    x = float(frame.position[0])
    assert plan[:, 0].max() == pytest.approx(x + 1.0, abs=0.1)
    assert heavy[:, 0].max() > x + 0.7


def test_a_small_robot_is_followed(ring):
    small = dataclasses.replace(ring, robot_radius=0.02, footprint=0.1 * ring.footprint)
    extents = set()
    for frame in ring.frames:
        image = path_frame_image(small, bare(frame), side=600)
        rows, columns = np.nonzero(near(image, ROBOT))
        assert columns.size > 50
        assert 0 < columns.mean() < 600
        extents.add(image.size)
        assert image.size == (600, 375 + FOOTER)
        # Inside the course the robot is in the middle.
        if abs(frame.position[0]) < 4.5 and abs(frame.position[1]) < 4.5:
            assert [columns.mean(), rows.mean()] == pytest.approx([300, 187], abs=10)
    assert len(extents) == 1


def test_values_that_are_not_finite_are_left_out(ring):
    frame = ring.frames[1]
    samples, weights, corners = frame.samples.copy(), frame.weights.copy(), frame.corners.copy()
    samples[0], weights[1], corners[0] = np.nan, np.nan, np.inf
    broken = dataclasses.replace(
        frame, samples=samples, weights=weights, corners=corners, heading=np.nan
    )
    path_frame_image(ring, broken)


def test_a_picture_that_is_too_small_for_its_footer_is_refused(ring):
    with pytest.raises(ValueError, match="side is 319; accepted"):
        path_frame_image(ring, ring.frames[-1], side=319)


def test_the_strip_says_how_far_it_is(ring, straight, written):
    def strip(run, step):
        written.clear()
        (frame,) = [frame for frame in run.frames if frame.step == step]
        path_frame_image(run, frame, side=720)
        return [words for words, _ in written]

    assert strip(straight, 0)[:4] == ["0.0 m/s", "speed", "0.0 m", "0.0 s"]
    assert strip(straight, 7)[:4] == ["2.0 m/s", "speed", "7.0 m", "3.5 s"]
    assert strip(straight, 7)[4:] == ["1 m", "robot", "trail", "plan", "rollouts", "path"]
    assert strip(ring, 13)[:4] == ["3.1 m/s", "speed", "lap 1 of 2", "6.5 s"]
    assert strip(ring, 27)[2] == "lap 2 of 2"
    # In the end too: there is no third lap.
    assert strip(ring, 40)[2] == "lap 2 of 2"
    assert strip(ring, 40)[-4:] == [
        *("corridor", "obstacle"),
        *("out of corridor", "contact"),
    ]


def test_colours_survive_in_the_file(ring, tmp_path):
    ring.write_animation(tmp_path / "run.gif")
    drawn = path_frame_image(ring, ring.frames[-1])
    with Image.open(tmp_path / "run.gif") as image:
        image.seek(image.n_frames - 1)
        shown = image.convert("RGB").crop((0, CAPTION, *image.size))
    for colour in (MOVER_EDGE, MISSED, PLAN, TRAIL, BEYOND):
        here, there = near(drawn, colour), near(shown, colour)
        assert here.sum() > 10
        assert there[here].mean() > 0.9
