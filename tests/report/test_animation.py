import dataclasses

import numpy as np
import pytest
from PIL import Image

from jaxplore.report.drawing.colours import CLOSED, CLOSED_SHARE, FREE, MOVER_EDGE, TARGET, blend
from jaxplore.report.drawing.palette import PLAN, ROBOT
from jaxplore.report.exploration.animation import frame_image, write_animation

POSE = (3.0, -2.0, 0.7)


def test_file_plays_every_frame_and_rests_on_the_last(recording, tmp_path):
    shares = []
    write_animation(recording, tmp_path / "run.gif", width=400, on_progress=shares.append)
    with Image.open(tmp_path / "run.gif") as image:
        assert image.n_frames == 4
        assert image.info["loop"] == 0
        durations = []
        for index in range(image.n_frames):
            image.seek(index)
            durations.append(image.info["duration"])
        assert durations == [90, 90, 90, 3000]
        shown = np.asarray(image.convert("RGB")).astype(int)
    assert shares == [0.25, 0.5, 0.75, 1.0]
    drawn = np.asarray(frame_image(recording, recording.frames[-1], width=400)).astype(int)
    assert np.abs(shown - drawn).mean() < 4.0


def test_frames_are_chosen_evenly_with_both_ends(make_recording, tmp_path):
    route = [(0.5 + 0.1 * k, 1.0) for k in range(21)]
    recording = make_recording(route, [0.04 * k for k in range(20)], num_frames=21)
    write_animation(recording, tmp_path / "run.gif", max_frames=5, width=320)
    with Image.open(tmp_path / "run.gif") as image:
        assert image.n_frames == 5
    write_animation(recording, tmp_path / "one.gif", max_frames=1, width=320)
    with Image.open(tmp_path / "one.gif") as image:
        assert getattr(image, "n_frames", 1) == 1
        shown = np.asarray(image.convert("RGB")).astype(int)
    last = np.asarray(frame_image(recording, recording.frames[-1], width=320)).astype(int)
    assert np.abs(shown - last).mean() < 4.0


def test_a_run_without_a_step(no_step, tmp_path):
    write_animation(no_step, tmp_path / "run.gif")
    with Image.open(tmp_path / "run.gif") as image:
        assert image.n_frames == 1


@pytest.mark.parametrize("shape", [(1, 1), (1, 400), (400, 1), (30, 10), (10, 200), (900, 1000)])
def test_any_shape_fits(make_recording, shape):
    middle = (0.05 * shape[1], 0.05 * shape[0])
    recording = make_recording([middle] * 2, [0.5], shape=shape)
    image = frame_image(recording, recording.frames[-1])
    assert 320 <= image.width <= 720
    assert 100 < image.height < 900


def test_the_robot_is_drawn_where_it_stands(make_recording):
    # Along its own axes a turned grid looks as if it were straight.
    route = [(0.6, 0.5), (2.4, 1.6)]
    images = []
    for origin in ((0.0, 0.0, 0.0), POSE):
        recording = make_recording(route, [0.5], origin=origin, num_frames=2)
        frame = recording.frames[-1]
        frame = dataclasses.replace(frame, plan=frame.plan[:0], samples=frame.samples[:0])
        frame = dataclasses.replace(frame, weights=frame.weights[:0], scan=frame.scan[:0])
        images.append(np.asarray(frame_image(recording, frame, width=480)).astype(int))
    rows, columns = np.nonzero(np.abs(images[0][:380] - PLAN).max(axis=-1) < 3)
    # 4.8 m of window are 480 pixels; row 0 of the grid is at the bottom.
    assert columns.mean() == pytest.approx((2.4 + 0.9) * 100, abs=3)
    assert rows.mean() == pytest.approx((2.9 - 1.6) * 100, abs=3)
    assert np.abs(images[0] - images[1]).mean() < 0.5


def test_values_that_are_not_finite_are_left_out(recording):
    frame = recording.frames[1]
    samples, weights, scan = frame.samples.copy(), frame.weights.copy(), frame.scan.copy()
    samples[0], weights[1], scan[3] = np.nan, np.nan, np.inf
    information = np.full_like(frame.information, np.nan)
    broken = dataclasses.replace(
        frame, samples=samples, weights=weights, scan=scan, information=information
    )
    frame_image(recording, broken)


@pytest.mark.parametrize(("name", "value"), [("max_frames", 0), ("width", 319)])
def test_arguments_that_make_no_sense(recording, tmp_path, name, value):
    with pytest.raises(ValueError, match=f"{name} is {value}; accepted"):
        write_animation(recording, tmp_path / "run.gif", **{name: value})
    assert not list(tmp_path.iterdir())


def bare(recording, **changes):
    """The last look without rollouts, plan and beams, which may lie over what is looked for."""
    frame = recording.frames[-1]
    frame = dataclasses.replace(frame, plan=frame.plan[:0], samples=frame.samples[:0])
    frame = dataclasses.replace(frame, weights=frame.weights[:0], scan=frame.scan[:0])
    # Nothing is known of the information, so the ground keeps its colour.
    frame = dataclasses.replace(frame, information=np.zeros_like(frame.information), **changes)
    recording = dataclasses.replace(recording, frames=(*recording.frames[:-1], frame))
    return np.asarray(frame_image(recording, frame, width=480)).astype(int)


def spots(image, colour) -> np.ndarray:
    """(x, y) [m] of what has a colour: 4.8 m of window are 480 pixels, its corner at -0.9 m."""
    rows, columns = np.nonzero(np.abs(image[:380] - colour).max(axis=-1) < 3)
    return np.stack([columns / 100 - 0.9, 2.9 - rows / 100], axis=-1)


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), POSE])
def test_movers_targets_and_ground_are_drawn_where_they_are(make_recording, make_vehicle, origin):
    run = make_recording([(0.6, 0.5), (0.8, 0.5)], [0.5], origin=origin, num_frames=2)
    image = bare(make_vehicle(run))
    edge = spots(image, MOVER_EDGE)
    # The map is 3 m by 2 m; one disc at (1.8, 1.5), one at (2.1, 0.5).
    for middle, radius in (((1.8, 1.5), 0.2), ((2.1, 0.5), 0.3)):
        distance = np.hypot(*(edge - middle).T)
        near = distance < radius + 0.05
        assert near.sum() > 20
        assert distance[near].min() > radius - 0.06
        assert distance[near].max() < radius + 0.02
    stars = spots(image, TARGET)
    for target in ((0.6, 1.6), (1.5, 0.6), (2.7, 1.2)):
        near = np.hypot(*(stars - target).T) < 0.1
        assert near.sum() > 10
        np.testing.assert_allclose(stars[near].mean(axis=0), target, atol=0.02)
    closed = spots(image, blend(CLOSED, FREE, CLOSED_SHARE))
    # From column 18 and row 12 of 0.1 m on, as far as the walls.
    np.testing.assert_allclose(closed.min(axis=0), [1.8, 1.2], atol=0.03)
    np.testing.assert_allclose(closed.max(axis=0), [2.9, 1.9], atol=0.03)


@pytest.mark.parametrize(("yaw", "extent"), [(0.0, (0.6, 0.3)), (0.5 * np.pi, (0.3, 0.6))])
def test_a_rectangle_is_drawn_along_its_heading(make_recording, make_vehicle, yaw, extent):
    vehicle = make_vehicle(make_recording([(0.8, 0.5)] * 2, [0.5], num_frames=2))
    robot = spots(bare(vehicle, heading=yaw), ROBOT)
    # Less the white edge.
    np.testing.assert_allclose(np.ptp(robot, axis=0), extent, atol=0.05)
    # Its position is 0.1 m behind its middle.
    middle = np.array([0.8, 0.5]) + 0.1 * np.array([np.cos(yaw), np.sin(yaw)])
    found = 0.5 * (robot.min(axis=0) + robot.max(axis=0))
    np.testing.assert_allclose(found, middle, atol=0.03)


def test_a_rectangle_that_is_small_in_the_picture_keeps_its_shape(make_recording, make_vehicle):
    vehicle = make_vehicle(make_recording([(20.0, 10.0)] * 2, [0.5], shape=(200, 400)))
    frame = dataclasses.replace(vehicle.frames[-1], plan=vehicle.frames[-1].plan[:0])
    frame = dataclasses.replace(frame, samples=frame.samples[:0], weights=frame.weights[:0])
    image = np.asarray(frame_image(vehicle, frame, width=420)).astype(int)
    rows, columns = np.nonzero(np.abs(image[:220] - ROBOT).max(axis=-1) < 3)
    # 10 pixels a metre, so it would be 3 pixels wide; it is 13, less the edge, and twice as long.
    assert np.ptp(rows) == pytest.approx(11, abs=2)
    assert np.ptp(columns) == pytest.approx(24, abs=2)


def test_without_a_heading_a_rectangle_is_a_disc(vehicle):
    robot = spots(bare(vehicle, heading=np.nan), ROBOT)
    # Of its radius, 0.2 m.
    np.testing.assert_allclose(np.ptp(robot, axis=0), [0.38, 0.38], atol=0.03)


def test_movers_that_are_nowhere_are_left_out(vehicle):
    movers = np.array([[np.nan, 1.0], [np.inf, np.inf]], np.float32)
    assert not len(spots(bare(vehicle, movers=movers), MOVER_EDGE))


def test_colours_of_what_a_vehicle_has_survive_in_the_file(vehicle, tmp_path):
    write_animation(vehicle, tmp_path / "run.gif", width=640)
    with Image.open(tmp_path / "run.gif") as image:
        image.seek(image.n_frames - 1)
        shown = np.asarray(image.convert("RGB")).astype(int)
    drawn = np.asarray(frame_image(vehicle, vehicle.frames[-1], width=640)).astype(int)
    assert np.abs(shown - drawn).mean() < 4.0
    for colour in (TARGET, MOVER_EDGE, blend(CLOSED, FREE, CLOSED_SHARE)):
        here, there = (np.abs(each - colour).max(axis=-1) < 5 for each in (drawn, shown))
        assert here.sum() > 30
        assert there[here].mean() > 0.9


def test_the_strip_names_what_there_is(recording, vehicle):
    plain, full = (
        np.asarray(frame_image(each, each.frames[-1], width=720)).astype(int)
        for each in (recording, vehicle)
    )
    strips = [each[-84:] for each in (plain, full)]
    for colour in (TARGET, blend(CLOSED, FREE, CLOSED_SHARE)):
        found = [(np.abs(strip - colour).max(axis=-1) < 2).sum() for strip in strips]
        assert found[0] == 0
        assert found[1] > 60
