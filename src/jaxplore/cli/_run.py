"""`jaxplore run`: simulates one run and writes its folder."""

import warnings
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from jaxplore._text import printable_path
from jaxplore.cli._entries import option_entries
from jaxplore.cli._memory import check_memory, memory_limit
from jaxplore.cli._pictures import take_pictures
from jaxplore.cli._show import free_name, reserve, save, show_goal, show_starts
from jaxplore.cli._view_options import VIEW
from jaxplore.recorder.recorder import McapRecorder, RecordingWarning, check_recording
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.loop import initial_loop_state
from jaxplore.simulation.run import NUM_TRAJECTORIES, Run, simulate
from jaxplore.tasks.registry import build, find_kind, folder_name, make_settings

SETTINGS = "settings.yaml"
"""File of the settings in a run folder."""


def run_one(options: dict[str, Any], out: Path | None, *, overwrite: bool) -> None:
    """Simulate one run, write its folder and print its metrics.

    The exit code is 130 if the user stopped it. A recording that could not be written raises a
    `ValueError` after the run folder has been written.
    """
    pictures = take_pictures(options, overwrite=overwrite)
    limit = memory_limit(options)
    record, resume = options.pop("record"), options.pop("resume")
    recorder = None
    if record is not None:
        check_recording(record, overwrite=overwrite, name="--record")
        recorder = McapRecorder(record, overwrite=overwrite)
    if resume is not None:
        _take_settings(options, resume)
        out = resume if out is None else out
    wanted = {name: options.pop(name) for name in VIEW}
    has_view = any(each is not None for each in wanted.values())
    if has_view and resume is not None:
        raise ValueError(
            f"--resume is {printable_path(resume)!r} beside --view; accepted: one of them"
        )
    given = option_entries(options)
    # A map is read to find a start on it.
    check_memory([make_settings(given)], limit)
    entries = find_kind(given).with_start(given)
    settings = make_settings(entries)
    beside = {"--record": record, "--resume": resume, "--view": has_view or None}
    workers = _workers(settings, beside)
    folder = free_name(Path("runs") / folder_name(entries)) if out is None else out
    # The folder is checked before the run, which may take minutes.
    reserve(folder, overwrite=overwrite)
    former = None if resume is None else Run.load(resume)
    if has_view:
        # viser takes a second to import.
        from jaxplore.cli._view import open_view, run_viewed

        with closing(open_view(**wanted, folder=folder)) as view:
            show_starts({"": given}, {"": entries})
            run_viewed(view, settings, folder, pictures, recorder, overwrite=overwrite)
        return
    experiment = build(settings)
    if former is not None:
        _check_continues(former, experiment, resume)
    show_starts({"": given}, {"": entries})
    show_goal(settings, experiment.scenario)
    num_trajectories = NUM_TRAJECTORIES if pictures.animation or pictures.video else 0
    if former is not None:
        # All frames of a run have as many rollouts.
        num_trajectories = sum(_rollouts(each) for each in former.recording.frames[:1])
    elif recorder is not None:
        num_trajectories = NUM_TRAJECTORIES
    if workers > 1:
        save(
            _in_parts(experiment, workers, num_trajectories),
            folder,
            settings,
            pictures,
            overwrite=overwrite,
            recording=None,
        )
        return
    with warnings.catch_warnings():
        # The same text is the error of the command.
        warnings.simplefilter("ignore", RecordingWarning)
        result = simulate(
            *experiment[:3],
            key=experiment.key,
            progress=True,
            num_trajectories=num_trajectories,
            resume=former,
            monitors=() if recorder is None else (recorder,),
        )
    try:
        save(result, folder, settings, pictures, overwrite=overwrite, recording=record)
    finally:
        if recorder is not None and recorder.failure is not None:
            raise ValueError(recorder.failure)


def _workers(settings: Any, beside: Mapping[str, Path | bool | None]) -> int:
    """Return the number of workers among which the robots of a fleet are divided; 1 for none.

    `beside` has options that need the robots in one process, with None for what is not given. One
    of them beside several workers, and more workers than robots, raise a `ValueError`.
    """
    fleet = getattr(settings, "fleet", None)
    if fleet is None or fleet.workers == 1:
        return 1
    if fleet.workers > fleet.robots:
        raise ValueError(
            f"fleet.workers is {fleet.workers} for {fleet.robots} robots; accepted: at most one "
            "for each"
        )
    for name, given in beside.items():
        if given is not None:
            raise ValueError(
                f"fleet.workers is {fleet.workers} beside {name}; accepted: 1, which computes all "
                "robots in one process"
            )
    return int(fleet.workers)


def _in_parts(experiment: Experiment, workers: int, num_trajectories: int) -> Run:
    """Simulate a fleet in the workers of a local Ray cluster.

    It raises a `ValueError` if Ray is not installed, or if a worker failed or died.
    """
    from jaxplore.study.fleet_parts import simulate_in_parts

    controller, scenario, num_steps, key = experiment
    try:
        return simulate_in_parts(
            controller,  # type: ignore[arg-type]
            scenario,  # type: ignore[arg-type]
            num_steps,
            key=key,
            workers=workers,
            progress=True,
            num_trajectories=num_trajectories,
        )
    except ChildProcessError as error:
        raise ValueError(str(error)) from error


def _rollouts(frame: Any) -> int:
    """Return the number of rollouts of which a frame was made."""
    # Frames of other tasks, and of several robots, show the plan alone.
    number = len(getattr(frame, "samples", ()))
    return number or (NUM_TRAJECTORIES if frame.plan.size else 0)


def _take_settings(options: dict[str, Any], folder: Path) -> None:
    """Put the settings file of a run folder among the options, which must have none yet."""
    if options["settings_file"] is not None:
        raise ValueError(
            f"--settings is {printable_path(options['settings_file'])!r} beside --resume; "
            "accepted: one of them"
        )
    file = folder / SETTINGS
    if not file.is_file():
        raise ValueError(
            f"--resume is {printable_path(folder)!r}, which holds no {SETTINGS}; accepted: a run "
            "folder that jaxplore run wrote"
        )
    options["settings_file"] = file


def _check_continues(former: Run, experiment: Experiment, folder: Path) -> None:
    """Check that an experiment continues an unfinished run, before the progress bar appears."""
    recording, (controller, scenario, limit, key) = former.recording, experiment
    if recording.num_steps >= limit:
        done, most = (steps * recording.control_period for steps in (recording.num_steps, limit))
        raise ValueError(
            f"--resume is {printable_path(folder)!r}, a run of {done:g} s, beside a time limit of "
            f"{most:g} s; accepted: a greater --time-limit, for a run that is not finished"
        )
    if former.checkpoint is not None:
        former.checkpoint.check(controller, scenario, key, limit)
        former.checkpoint.state(scenario, initial_loop_state(controller, scenario, key))
