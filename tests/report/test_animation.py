import dataclasses

import numpy as np
import pytest
from PIL import Image, ImageFont

from jaxplore.report.drawing.colours import (
    CLOSED,
    CLOSED_SHARE,
    FREE,
    MOVER_EDGE,
    OCCUPIED,
    TARGET,
    UNKNOWN,
    blend,
)
from jaxplore.report.drawing.film import CAPTION, FilmOptions
from jaxplore.report.drawing.footer import BAR_TOP, STRIP, footer_height
from jaxplore.report.drawing.palette import HIDDEN_WALL, INK, PLAN, ROBOT
from jaxplore.report.exploration.animation import frame_image
from jaxplore.report.exploration.canvas import make_canvas
from jaxplore.report.following.animation import path_frame_image

POSE = (3.0, -2.0, 0.7)


@pytest.mark.parametrize(("name", "draw"), [("recording", frame_image), ("ring", path_frame_image)])
def test_file_plays_every_frame_and_rests_on_the_last(name, draw, request, tmp_path):
    shares, recording = [], request.getfixturevalue(name)
    recording.write_animation(tmp_path / "run.gif", on_progress=shares.append)
    with Image.open(tmp_path / "run.gif") as image:
        assert image.n_frames == 4
        assert image.info["loop"] == 0
        durations = []
        for index in range(image.n_frames):
            image.seek(index)
            durations.append(image.info["duration"])
        assert durations == [100, 100, 100, 3000]
        shown = np.asarray(image.convert("RGB")).astype(int)[CAPTION:]
    assert shares == [0.25, 0.5, 0.75, 1.0]
    drawn = np.asarray(draw(recording, recording.frames[-1])).astype(int)
    assert np.abs(shown - drawn).mean() < 4.0


def test_frames_are_chosen_evenly_with_both_ends(make_recording, tmp_path):
    route = [(0.5 + 0.1 * k, 1.0) for k in range(21)]
    recording = make_recording(route, [0.04 * k for k in range(20)], num_frames=21)
    recording.write_animation(tmp_path / "run.gif", FilmOptions(max_frames=5))
    with Image.open(tmp_path / "run.gif") as image:
        assert image.n_frames == 5
    recording.write_animation(tmp_path / "one.gif", FilmOptions(max_frames=1))
    with Image.open(tmp_path / "one.gif") as image:
        assert getattr(image, "n_frames", 1) == 1
        shown = np.asarray(image.convert("RGB")).astype(int)[CAPTION:]
    last = np.asarray(frame_image(recording, recording.frames[-1])).astype(int)
    assert np.abs(shown - last).mean() < 4.0


def test_a_run_without_a_step(no_step, tmp_path):
    no_step.write_animation(tmp_path / "run.gif")
    with Image.open(tmp_path / "run.gif") as image:
        assert image.n_frames == 1


@pytest.mark.parametrize("shape", [(1, 1), (1, 400), (400, 1), (30, 10), (10, 200), (900, 1000)])
def test_any_shape_fits(make_recording, shape):
    middle = (0.05 * shape[1], 0.05 * shape[0])
    recording = make_recording([middle] * 2, [0.5], shape=shape)
    image = frame_image(recording, recording.frames[-1])
    assert 320 <= image.width <= 720
    assert 100 < image.height < 720 * 1.1 + footer_height(320.0, 9) + 1


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


def test_a_picture_that_is_too_small_for_its_footer_is_refused(recording):
    with pytest.raises(ValueError, match="width is 319; accepted"):
        frame_image(recording, recording.frames[-1], width=319)


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
    vehicle.write_animation(tmp_path / "run.gif")
    with Image.open(tmp_path / "run.gif") as image:
        image.seek(image.n_frames - 1)
        shown = np.asarray(image.convert("RGB")).astype(int)[CAPTION:]
    drawn = np.asarray(frame_image(vehicle, vehicle.frames[-1])).astype(int)
    assert np.abs(shown - drawn).mean() < 4.0
    for colour in (TARGET, MOVER_EDGE, blend(CLOSED, FREE, CLOSED_SHARE)):
        here, there = (np.abs(each - colour).max(axis=-1) < 5 for each in (drawn, shown))
        assert here.sum() > 30
        assert there[here].mean() > 0.9


def names(recording) -> list[str]:
    return [entry.name for entry in make_canvas(recording, 720, 1.0).legend]


def test_the_legend_names_what_is_drawn_and_nothing_else(recording, vehicle):
    plain = ["robot", "trail", "plan", "rollouts", "lidar", "information", "unknown", "wall"]
    plain.append("unseen wall")
    assert names(recording) == plain
    assert names(vehicle) == [*plain, "target", "target found", "mover", "untraversable"]
    reference = np.array([[0.5, 1.0], [1.5, 1.0]], np.float32)
    frames = [dataclasses.replace(each, reference=reference) for each in recording.frames]
    guided = dataclasses.replace(recording, frames=tuple(frames), goal=np.array([2.0, 1.0]))
    assert set(names(guided)) - set(plain) == {"reference", "goal"}
    bare = [
        dataclasses.replace(each, plan=each.plan[:0], samples=each.samples[:0])
        for each in recording.frames
    ]
    alone = dataclasses.replace(recording, frames=tuple(bare))
    assert set(plain) - set(names(alone)) == {"plan", "rollouts"}


@pytest.mark.parametrize("width", [320, 480, 720])
@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_the_legend_lies_below_the_curve_and_inside_the_picture(vehicle, written, width, scale):
    image = frame_image(vehicle, vehicle.frames[-1], width=width, scale=scale)
    entries = names(vehicle)
    top = image.height / scale - footer_height(image.width / scale, len(entries))
    places = dict(written)
    for name in entries:
        x, y = places[name]
        assert y / scale >= top + STRIP
        assert y / scale + 16 <= image.height / scale
        assert (x + ImageFont.load_default(13 * scale).getlength(name)) <= image.width


def test_a_known_map_shows_idleness_targets_or_distance_and_not_coverage(
    vehicle, written, make_patrol
):
    def headline(run):
        written.clear()
        frame_image(run, run.frames[-1])
        return [words for words, _ in written[:2]]

    assert headline(vehicle) == ["99.0 %", "covered"]
    covered = np.ones_like(vehicle.records.coverage)
    seen_at_once = dataclasses.replace(vehicle, records=vehicle.records._replace(coverage=covered))
    assert headline(seen_at_once) == ["100.0 %", "covered"]
    known = dataclasses.replace(seen_at_once, initial_unknown=0.0)
    assert headline(known) == ["3", "targets found"]
    patrol = make_patrol(known)
    assert headline(patrol) == ["9.0 s", "mean idleness"]
    assert headline(dataclasses.replace(patrol, parts={})) == ["2.0 m", "driven"]


@pytest.mark.parametrize("scale", [1.0, 1.5, 2.0])
def test_the_scale_bar_has_the_length_that_it_names(recording, written, scale):
    image = frame_image(recording, recording.frames[-1], scale=scale)
    # After the number and its name, the time and the distance.
    told = written[4][0]
    # The window is 4.8 m wide.
    expected = float(told[:-2]) * image.width / 4.8
    top = image.height - footer_height(image.width / scale, len(names(recording))) * scale
    row = np.asarray(image).astype(int)[round(top + BAR_TOP * scale)]
    dark = np.flatnonzero(np.abs(row - INK).max(axis=-1) < 40)
    pieces = np.split(dark, np.flatnonzero(np.diff(dark) > 1) + 1)
    assert max(map(len, pieces)) == pytest.approx(expected, abs=3 * scale)


def test_a_larger_scale_is_drawn_and_not_enlarged(recording):
    frame = recording.frames[-1]
    small, large = (frame_image(recording, frame, scale=scale) for scale in (1.0, 2.0))
    assert large.size == (2 * small.width, 2 * small.height)
    # An enlarged picture has only the colours between those of neighbouring pixels; halved again,
    # a drawn one agrees with the small one but for the smoothing of edges.
    halved = np.asarray(large.reduce(2)).astype(int)
    assert np.abs(halved - np.asarray(small).astype(int)).mean() < 4.0
    enlarged = np.asarray(small.resize(large.size, Image.Resampling.BICUBIC)).astype(float)
    steps = [
        np.abs(np.diff(each.mean(axis=-1), axis=1)).max(axis=0)[30:700].mean()
        for each in (np.asarray(large).astype(float)[-250:], enlarged[-250:])
    ]
    assert steps[0] > 1.15 * steps[1]


def test_found_targets_have_another_shape(make_recording, make_vehicle):
    vehicle = make_vehicle(make_recording([(0.6, 0.5), (0.8, 0.5)], [0.5], num_frames=2))
    missing, found = (
        spots(bare(vehicle, parts={"targets": {"is_found": np.full(3, value)}}), TARGET)
        for value in (False, True)
    )
    # A ring is closed where a star has its gaps, which the halves of its tips do not fill.
    for target in vehicle.parts["targets"].places:
        around = []
        for each in (missing, found):
            offset = each - target
            rim = offset[np.abs(np.hypot(*offset.T) - 0.055) < 0.012]
            angles = np.arctan2(rim[:, 1], rim[:, 0])
            around.append(len(set(np.round(angles / (np.pi / 12)).astype(int).tolist())))
        assert around[0] <= 14
        assert around[1] >= 22


def test_walls_of_one_cell_are_visible_where_cells_share_a_pixel(make_recording):
    # 3000 cells on 720 pixels.
    recording = make_recording([(5.0, 5.0)] * 2, [0.5], shape=(100, 3000), num_frames=2)
    world = np.zeros_like(recording.world)
    world[20, 200:1200], world[80, 200:1200] = 1.0, 1.0
    frame = recording.frames[-1]
    level = np.full(world.shape, 128, np.uint8)
    level[:50] = np.round(255 * world[:50])
    frame = dataclasses.replace(frame, probability=level, information=0.0 * frame.information)
    known = dataclasses.replace(recording, world=world, frames=(recording.frames[0], frame))
    image = np.asarray(frame_image(known, frame)).astype(int)
    for colour in (HIDDEN_WALL, OCCUPIED):
        ground = UNKNOWN if colour == HIDDEN_WALL else FREE
        # In each column the most similar pixel is much nearer to the wall than to its ground.
        rows = image[:24, 80:260]
        share = (np.abs(rows - ground).sum(-1) / np.abs(np.subtract(colour, ground)).sum()).max(0)
        assert np.median(share) > 0.45
