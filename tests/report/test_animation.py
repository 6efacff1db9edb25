import dataclasses

import numpy as np
import pytest
from PIL import Image

from jaxplore.report.animation import PLAN, frame_image, write_animation

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
