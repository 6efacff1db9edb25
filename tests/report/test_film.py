import re
import subprocess

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from jaxplore.report.drawing.film import CAPTION, FilmOptions, describe_speed
from jaxplore.simulation.run import Run


def ffmpeg(*arguments: str) -> subprocess.CompletedProcess[bytes]:
    command = [imageio_ffmpeg.get_ffmpeg_exe(), *arguments]
    return subprocess.run(command, capture_output=True, check=False)


def frames_of(path, size: tuple[int, int]) -> np.ndarray:
    """Decode a video of a width and a height with ffmpeg itself."""
    data = ffmpeg("-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-").stdout
    return np.frombuffer(data, np.uint8).reshape(-1, size[1], size[0], 3)


def film_of(recording) -> Run:
    return Run(recording, recording.metrics())


def test_a_video_has_the_rate_the_size_and_the_pictures_of_the_run(recording, tmp_path):
    file = tmp_path / "run.mp4"
    film_of(recording).animate(file, fps=30, scale=1.5)
    told = ffmpeg("-i", str(file)).stderr.decode()
    assert re.search(r"h264.* 30 fps", told)
    drawn = [np.asarray(recording.frame_image(each, scale=1.5)) for each in recording.frames]
    height, width = drawn[0].shape[:2]
    caption = round(1.5 * CAPTION)
    # Rows and columns are even.
    size = (width + width % 2, height + caption + (height + caption) % 2)
    assert f"{size[0]}x{size[1]}" in told
    shown = frames_of(file, size)
    assert len(shown) == 4
    for each, expected in zip(shown, drawn, strict=True):
        found = each[caption : caption + height, :width].astype(int)
        assert np.abs(found - expected).mean() < 3.0


def test_the_same_run_gives_the_same_video(recording, tmp_path):
    for name in ("one.mp4", "other.mp4"):
        recording.write_animation(tmp_path / name, FilmOptions(scale=0.5))
    assert (tmp_path / "one.mp4").read_bytes() == (tmp_path / "other.mp4").read_bytes()


@pytest.mark.parametrize(("fps", "milliseconds"), [(10, 100), (30, 30), (24.0, 40), (50, 20)])
def test_the_caption_of_a_gif_tells_the_speed_at_which_it_plays(
    recording, written, tmp_path, fps, milliseconds
):
    recording.write_animation(tmp_path / "run.gif", FilmOptions(fps=fps), title="bold")
    with Image.open(tmp_path / "run.gif") as image:
        assert image.info["duration"] == milliseconds
    # Four frames of 5 s, so 5 / 3 s between them.
    (speed,) = {words for words, _ in written if "real time" in words}
    assert speed == f"{5.0 / 3.0 / (milliseconds / 1000.0):.0f} x real time"
    assert "bold" in {words for words, _ in written}


@pytest.mark.parametrize(
    ("speed", "words"),
    [
        (None, ""),
        (0.0, ""),
        (0.25, "0.25 x real time"),
        (1.0, "1 x real time"),
        (2.52, "2.5 x real time"),
        (16.7, "17 x real time"),
    ],
)
def test_speeds_in_words(speed, words):
    assert describe_speed(speed) == words


def test_without_a_path_the_film_is_for_a_notebook(recording, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    film = film_of(recording).animate(scale=0.5)
    assert not list(tmp_path.iterdir())
    assert film.data.startswith(b"GIF89a")
    assert re.match(r'<img alt="[\w ]+" src="data:image/gif;base64,R0lG', film._repr_html_())
    assert "GIF89" not in repr(film)
    video = film_of(recording).animate(tmp_path / "run.mp4", scale=0.5)
    assert video._repr_html_().startswith('<video controls loop src="data:video/mp4;base64,')
    assert video.data == (tmp_path / "run.mp4").read_bytes()


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("run.webm", {}, r"film is .*run.webm'; accepted: a file that ends in .gif or .mp4"),
        ("none/run.gif", {}, "accepted: a file in a folder that exists"),
        ("run.gif", {"fps": 60}, "fps of a GIF is 60.0; accepted"),
    ],
)
def test_arguments_that_make_no_sense(recording, tmp_path, name, options, message):
    with pytest.raises(ValueError, match=message):
        film_of(recording).animate(tmp_path / name, **options)
    assert not list(tmp_path.iterdir())


def test_a_film_that_fails_leaves_the_former_one(recording, tmp_path, monkeypatch):
    for name in ("run.gif", "run.mp4"):
        (tmp_path / name).write_bytes(b"former")

        def fail(share):
            raise RuntimeError("in the middle")

        with pytest.raises(RuntimeError, match="in the middle"):
            recording.write_animation(tmp_path / name, FilmOptions(scale=0.5), on_progress=fail)
        assert (tmp_path / name).read_bytes() == b"former"
    assert len(list(tmp_path.iterdir())) == 2


def test_a_video_without_imageio_ffmpeg_is_one_line(recording, tmp_path, monkeypatch):
    def missing(name, *others):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr("jaxplore._optional.importlib.import_module", missing)
    with pytest.raises(ValueError, match=r"imageio_ffmpeg is not installed.*\[video\]") as caught:
        recording.write_animation(tmp_path / "run.mp4")
    assert "\n" not in str(caught.value)
    recording.write_animation(tmp_path / "run.gif", FilmOptions(scale=0.5))


def test_a_video_plays_in_a_browser(recording, tmp_path):
    # Browsers decode H.264 with colours for two by two pixels, and want the index first.
    recording.write_animation(tmp_path / "run.mp4", FilmOptions(scale=0.5))
    data = (tmp_path / "run.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    assert "yuv420p" in ffmpeg("-i", str(tmp_path / "run.mp4")).stderr.decode()


def test_a_video_that_ffmpeg_cannot_write_is_one_line(recording, tmp_path, monkeypatch):
    # A program that reads nothing and fails stands for a full disk.
    program = tmp_path / "ffmpeg"
    program.write_text("#!/bin/sh\necho no space left >&2\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setattr("jaxplore.report.drawing.film._ffmpeg", lambda: str(program))
    with pytest.raises(ValueError, match=r"run.mp4' cannot be written: ffmpeg: no space left"):
        recording.write_animation(tmp_path / "run.mp4", FilmOptions(scale=0.5))
    assert [each.name for each in tmp_path.iterdir()] == ["ffmpeg"]
