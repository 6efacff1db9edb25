import errno
import json
import os

import numpy as np
import pytest
import yaml
from PIL import Image

from jaxplore.maps.files.ros import read_map
from jaxplore.report.exploration.evaluation import compute_metrics
from jaxplore.report.save import save_run

pytestmark = pytest.mark.long

FILES = [
    "arrays.npz",
    "coverage.png",
    "exploration.gif",
    "explored.pgm",
    "explored.yaml",
    "map.png",
    "metrics.json",
    "state.npz",
]


def names(path) -> list[str]:
    return sorted(each.name for each in path.iterdir())


def test_a_run_folder_holds_everything(recording, tmp_path):
    metrics, shares = compute_metrics(recording, seed=3), []
    settings = {"world": "depot", "lidar": {"num_beams": 360, "max_range": 8.0}, "seed": 3}
    save_run(recording, metrics, tmp_path / "run", settings=settings, on_progress=shares.append)
    assert names(tmp_path / "run") == sorted([*FILES, "settings.yaml"])
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)

    def refuse(constant):
        raise AssertionError(constant)

    text = (tmp_path / "run" / "metrics.json").read_text()
    assert json.loads(text, parse_constant=refuse) == metrics.as_dict()
    text = (tmp_path / "run" / "settings.yaml").read_text()
    assert yaml.safe_load(text) == settings
    assert list(yaml.safe_load(text)) == list(settings)
    for name in ("map.png", "coverage.png"):
        with Image.open(tmp_path / "run" / name) as image:
            image.load()
            assert image.format == "PNG"
            assert min(image.size) > 300
    with Image.open(tmp_path / "run" / "exploration.gif") as image:
        assert image.n_frames == 4


def test_arrays_hold_the_run(recording, tmp_path):
    save_run(recording, compute_metrics(recording), tmp_path / "run", animation=False)
    assert "exploration.gif" not in names(tmp_path / "run")
    with np.load(tmp_path / "run" / "arrays.npz", allow_pickle=False) as arrays:
        for name, rows in recording.records._asdict().items():
            if rows is not None and name != "parts":
                np.testing.assert_array_equal(arrays[name], rows)
        for name in ("positions", "world", "belief", "reachable", "origin", "start"):
            np.testing.assert_array_equal(arrays[name], getattr(recording, name))
        np.testing.assert_allclose(arrays["time"], np.arange(11) * 0.5)
        assert arrays["resolution"] == 0.1
        assert arrays["control_period"] == 0.5
        assert tuple(arrays["state_names"]) == recording.state_names


def test_the_explored_map_is_a_ros_map(make_recording, tmp_path):
    belief = np.linspace(0.0, 1.0, 600, dtype=np.float32).reshape(20, 30)
    pose, positions = (1.5, -2.0, 0.3), [(0.5, 1.0), (0.7, 1.0)]
    recording = make_recording(positions, [0.5], origin=pose, belief=belief)
    save_run(recording, compute_metrics(recording), tmp_path / "run", animation=False)
    # PyYAML and Pillow alone: what map_server reads.
    entries = yaml.safe_load((tmp_path / "run" / "explored.yaml").read_text())
    with Image.open(tmp_path / "run" / entries["image"]) as image:
        occupancy = 1.0 - np.asarray(image)[::-1] / 255.0
    assert entries["mode"] == "trinary"
    np.testing.assert_array_equal(occupancy > entries["occupied_thresh"], belief > 0.65)
    np.testing.assert_array_equal(occupancy < entries["free_thresh"], belief < 0.25)
    np.testing.assert_allclose(entries["origin"], pose, rtol=1e-6)
    found, resolution, origin = read_map(tmp_path / "run" / "explored.yaml")
    expected = np.where(belief > 0.65, 1.0, np.where(belief < 0.25, 0.0, 0.5))
    np.testing.assert_array_equal(found, expected)
    assert resolution == recording.resolution
    np.testing.assert_array_equal(np.float32(origin), recording.origin)


OPTIONAL = ["elevation", "traversable", "mover_radii", "footprint"]


def test_arrays_hold_what_a_ground_vehicle_has_besides(recording, vehicle, tmp_path):
    for each, name in ((vehicle, "full"), (recording, "plain")):
        save_run(each, compute_metrics(each), tmp_path / name, animation=False)
    files = [name for name in FILES if "gif" not in name]
    assert names(tmp_path / "plain") == files
    assert names(tmp_path / "full") == sorted([*files, "members.png"])
    with np.load(tmp_path / "full" / "arrays.npz", allow_pickle=False) as arrays:
        members = vehicle.records.members._asdict()
        for name, rows in members.items():
            np.testing.assert_array_equal(arrays[f"members_{name}"], rows)
        assert tuple(arrays["member_names"]) == vehicle.member_names
        for name in OPTIONAL:
            np.testing.assert_array_equal(arrays[name], getattr(vehicle, name))
        np.testing.assert_array_equal(arrays["is_untraversable"], vehicle.records.is_untraversable)
        parts = {}
        for record in vehicle.records.parts.values():
            parts |= record._asdict()
        assert {"mean_idleness", "is_tipped", "targets_seen"} <= set(parts)
        parts["idleness"] = vehicle.parts["watch"].idleness
        parts["targets"] = vehicle.parts["targets"].places
        for name, rows in parts.items():
            np.testing.assert_array_equal(arrays[name], rows)
        added = {f"members_{name}" for name in members} | {"member_names", *OPTIONAL, *parts}
        full = set(arrays)
    with np.load(tmp_path / "plain" / "arrays.npz", allow_pickle=False) as arrays:
        assert full - set(arrays) == added
        assert set(arrays) <= full


def test_a_ground_vehicle_without_a_step_can_be_saved(no_step, make_vehicle, tmp_path):
    vehicle = make_vehicle(no_step)
    save_run(vehicle, compute_metrics(vehicle), tmp_path / "run")
    assert names(tmp_path / "run") == sorted([*FILES, "members.png"])


@pytest.mark.parametrize("animation", [False, True])
def test_a_run_without_a_step_can_be_saved(no_step, tmp_path, animation):
    save_run(no_step, compute_metrics(no_step), tmp_path / "run", animation=animation)
    assert names(tmp_path / "run") == [name for name in FILES if animation or "gif" not in name]


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_disk_that_fills_leaves_what_was_there(recording, tmp_path, monkeypatch, overwrite):
    metrics = compute_metrics(recording)
    if overwrite:
        save_run(recording, metrics, tmp_path / "run", animation=False)
    before = sorted(tmp_path.rglob("*"))

    def fail(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(ValueError, match=r"run' cannot be written: No space left"):
        save_run(recording, metrics, tmp_path / "run", overwrite=overwrite)
    assert sorted(tmp_path.rglob("*")) == before


def test_ctrl_c_while_drawing_leaves_out_the_animation_only(recording, tmp_path):
    def interrupt(share):
        if 0.5 < share < 1.0:
            raise KeyboardInterrupt

    save_run(recording, compute_metrics(recording), tmp_path / "run", on_progress=interrupt)
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert names == set(FILES) - {"exploration.gif"}


def test_overwrite(recording, tmp_path):
    metrics = compute_metrics(recording)
    save_run(recording, metrics, tmp_path / "run", settings={"a": 1}, animation=False)
    with pytest.raises(ValueError, match="former run"):
        save_run(recording, metrics, tmp_path / "run", animation=False)
    save_run(recording, metrics, tmp_path / "run", animation=False, overwrite=True)
    assert "settings.yaml" not in names(tmp_path / "run")


def test_settings_that_are_not_plain_are_refused_before_anything_is_written(recording, tmp_path):
    with pytest.raises(ValueError, match="settings cannot be written as YAML") as caught:
        save_run(
            recording, compute_metrics(recording), tmp_path / "run", settings={"a": np.ones(2)}
        )
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())
