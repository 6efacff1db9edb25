"""Run folders that are read again."""

import dataclasses
import io
import json
import pickle
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxplore
from jaxplore.report import recording_arrays
from jaxplore.report.recording_arrays import load_run
from jaxplore.report.save import save_run
from jaxplore.simulation.run import Run

pytestmark = pytest.mark.long


def drawn(draw) -> bytes:
    stream = io.BytesIO()
    draw().savefig(stream, format="raw", dpi=50)
    return stream.getvalue()


@pytest.mark.parametrize("kind", ["recording", "vehicle", "no_step", "straight"])
def test_a_run_that_is_read_equals_the_one_that_was_written(kind, request, tmp_path) -> None:
    if kind == "straight":
        saved = request.getfixturevalue("make_straight")()
    else:
        saved = request.getfixturevalue(kind)
    metrics = saved.metrics(seed=5)
    metrics = dataclasses.replace(metrics, versions=metrics.versions | {"jax": "0.0.1"})
    save_run(saved, metrics, tmp_path / "run", animation=False)
    run = Run.load(tmp_path / "run")
    assert type(run.recording) is type(saved)
    assert run.metrics == metrics
    for field in dataclasses.fields(saved):
        pair = [getattr(each, field.name) for each in (run.recording, saved)]
        if field.name in ("frames", "timing"):
            pair = [
                [vars(one) for one in (each if field.name == "frames" else [each])] for each in pair
            ]
        elif field.name == "parts":
            assert [type(one) for one in pair[0].values()] == [
                type(one) for one in pair[1].values()
            ]
            pair = [{name: vars(one) for name, one in each.items()} for each in pair]
        leaves = [jax.tree.flatten(each) for each in pair]
        assert leaves[0][1] == leaves[1][1]
        for mine, theirs in zip(leaves[0][0], leaves[1][0], strict=True):
            assert type(mine) is type(theirs)
            np.testing.assert_array_equal(mine, theirs)
    for mine, theirs in zip(run.recording.frames, saved.frames, strict=True):
        assert type(mine) is type(theirs)
    assert run.recording.figures().keys() == saved.figures().keys()
    for name, draw in saved.figures().items():
        assert drawn(run.recording.figures()[name]) == drawn(draw)
    if saved.frames:
        images = [each.frame_image(each.frames[-1]).tobytes() for each in (run.recording, saved)]
        assert images[0] == images[1]


def test_a_process_that_knows_no_part_reads_what_a_run_shows_of_its_parts(vehicle, tmp_path):
    save_run(vehicle, vehicle.metrics(), tmp_path / "run", animation=False)
    code = (
        "import sys\n"
        "from jaxplore.simulation.run import Run\n"
        "assert not any(name.startswith('jaxplore.parts') for name in sys.modules)\n"
        "print(sorted(type(each).__name__ for each in Run.load('run').recording.parts.values()))\n"
    )
    command = [sys.executable, "-c", code]
    told = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    assert told.stdout.strip() == "['TargetReport', 'WatchReport', 'WheelReport']"


def test_only_modules_of_parts_are_imported(vehicle) -> None:
    for module in ("this", "jaxplore.parts", "jaxplore.parts.wheels.report.this", 3, None):
        packed = {"part": "WheelReport", "module": module, "fields": {}}
        assert recording_arrays._make_part(packed, {}) == vehicle.parts["wheels"]
    assert "this" not in sys.modules
    reports = Path(jaxplore.__file__).parent.glob("parts/*/report.py")
    names = [f"jaxplore.parts.{each.parent.name}.report" for each in reports]
    assert names
    assert all(map(recording_arrays._OF_A_PART.fullmatch, names))


@pytest.fixture(scope="module")
def written_once(tmp_path_factory):
    """Return where a run was written: its pictures take longer than all that is tested here."""
    return tmp_path_factory.mktemp("written") / "run"


@pytest.fixture
def folder(recording, written_once, tmp_path):
    """Return a run folder of the recording, to damage."""
    if not written_once.exists():
        save_run(recording, recording.metrics(), written_once, animation=False)
    return shutil.copytree(written_once, tmp_path / "run")


def changed(folder, **arrays) -> None:
    with np.load(folder / recording_arrays.NAME) as held:
        known = {name: held[name] for name in held if name not in arrays}
    known |= {name: each for name, each in arrays.items() if each is not None}
    np.savez(folder / recording_arrays.NAME, **known)


def restructured(folder, change) -> None:
    with np.load(folder / recording_arrays.NAME) as held:
        structure = json.loads(held["structure"].tobytes())
    change(structure)
    changed(folder, structure=np.frombuffer(json.dumps(structure).encode(), np.uint8))


DAMAGE = {
    "is not there": lambda folder: (folder / recording_arrays.NAME).unlink(),
    "metrics.json is not there": lambda folder: (folder / "metrics.json").unlink(),
    "cannot be loaded": lambda folder: (folder / recording_arrays.NAME).write_bytes(b"PK nothing"),
    "Expecting value": lambda folder: (folder / "metrics.json").write_text("no JSON"),
    "'versions'": lambda folder: (folder / "metrics.json").write_text("{}"),
    "fields/world": lambda folder: changed(folder, **{"fields/world": None}),
    "differ in length": lambda folder: changed(folder, **{"fields/records/coverage": np.zeros(3)}),
    "and type object": lambda folder: changed(folder, world=np.array([{}, 1], object)),
    "Recording 'system' is of a module not imported": lambda folder: restructured(
        folder, lambda structure: structure.update(kind="system")
    ),
    "missing or unknown: world": lambda folder: restructured(
        folder, lambda structure: structure["fields"].pop("world")
    ),
    "'far' and not of type": lambda folder: restructured(
        folder, lambda structure: structure["fields"].update(resolution={"value": "far"})
    ),
}


@pytest.mark.parametrize("expected", DAMAGE)
def test_a_damaged_folder_gets_one_line(expected, folder) -> None:
    DAMAGE[expected](folder)
    with pytest.raises(ValueError, match=expected) as caught:
        Run.load(folder)
    assert "\n" not in str(caught.value)
    assert "accepted: " in str(caught.value)


def test_folders_that_are_too_large_or_hold_programs_are_refused(folder, monkeypatch) -> None:
    monkeypatch.setattr(recording_arrays, "CONTENT_LIMIT", 1000)
    with pytest.raises(ValueError, match="it holds more than 1000 bytes"):
        load_run(folder, lambda *_: None)
    monkeypatch.setattr(recording_arrays, "FILE_LIMIT", 1000)
    with pytest.raises(ValueError, match="is too large; accepted: at most 1000 bytes"):
        load_run(folder, lambda *_: None)
    monkeypatch.undo()
    with zipfile.ZipFile(folder / recording_arrays.NAME, "w") as archive:
        archive.writestr("structure.npy", pickle.dumps(print))
    with pytest.raises(ValueError, match="cannot be loaded"):
        load_run(folder, lambda *_: None)


def test_a_recording_of_other_things_is_saved_but_cannot_be_loaded(recording, tmp_path) -> None:
    frames = tuple(
        dataclasses.replace(frame, scan=np.zeros((index, 2)))
        for index, frame in enumerate(recording.frames)
    )
    other = dataclasses.replace(recording, frames=frames)
    save_run(other, other.metrics(), tmp_path / "run", animation=False)
    with pytest.raises(ValueError, match="is not there or not a file; accepted: a run folder"):
        Run.load(tmp_path / "run")


def test_a_folder_without_a_newer_field_has_its_default(folder) -> None:
    restructured(folder, lambda structure: structure["fields"].pop("given_up_step"))
    assert Run.load(folder).recording.given_up_step is None
