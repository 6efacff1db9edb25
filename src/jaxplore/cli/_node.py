"""`jaxplore node` and `jaxplore robot`: drive a robot over ROS 2, and simulate one."""

import math
import sys
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import jax

from jaxplore._exit import FAILED, INTERRUPTED
from jaxplore._limits import LONGEST_LATENCY
from jaxplore._signals import stop_requests
from jaxplore._text import short_repr
from jaxplore.cli._entries import assign, assign_all, option_entries
from jaxplore.cli._identify import read_motors
from jaxplore.cli._memory import check_memory, memory_limit
from jaxplore.cli._show import free_name, reserve, show_starts
from jaxplore.cli._terminal import say
from jaxplore.cli._view_options import VIEW
from jaxplore.onboard.pilot import Pilot
from jaxplore.onboard.session import read_session_settings
from jaxplore.onboard.simulated_robot import SimulatedRobot
from jaxplore.recorder.recorder import McapRecorder, check_recording
from jaxplore.report.console import progress_bar
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.report.folder import lock_folder, write_whole
from jaxplore.report.table import print_table
from jaxplore.ros import control, goal, path_action, robot
from jaxplore.ros.further_lidars import further_lidars
from jaxplore.ros.link import connect, import_ros
from jaxplore.ros.replay import replay, replay_topics
from jaxplore.sensing.mount import MOST_MOUNT
from jaxplore.sensing.no_echo import NoEcho
from jaxplore.settings.code_names import check_trusted
from jaxplore.settings.node import NodeSettings, cloud_view, full_topic
from jaxplore.settings.readers import read_values
from jaxplore.settings.ros_names import check_namespace
from jaxplore.settings.sections import read_settings
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.monitor import Monitor
from jaxplore.simulation.run import Run
from jaxplore.tasks.exploration.pilot import (
    build_goal_chooser,
    build_pilot,
    check_no_mount,
    make_node_settings,
    open_session,
)
from jaxplore.tasks.exploration.settings import Settings
from jaxplore.tasks.registry import build, find_kind, folder_name, make_settings

_MOST = {"delay": LONGEST_LATENCY, "drift": 1.0}
"""Greatest values of options of the simulated robot."""
COMMANDS = "commands.csv"
"""File of a run folder with the velocity commands of a drive."""


def drive(options: dict[str, Any]) -> None:
    """Drive a robot until it is done or the user stops it, and write a run folder.

    The exit code is 130 if the user stopped it, and 1 if the robot was gone for too long.
    """
    if options["mode"] == "controller":
        # Without it nothing needs to be compiled.
        path_action.check_nav2(import_ros())
    settings, node, folder = _drive_settings(options)
    if node.mode == "goal":
        choose_goals(settings, node)
        return
    with ExitStack() as stack:
        monitors = _monitors(options, folder, stack)
        if node.session is not None:
            stack.enter_context(lock_folder(Path(node.session), "session"))
        session = open_session(settings, node)
        pilot = build_pilot(settings, node, session=session)
        recording = None
        say("Compiling, a few seconds ...", err=True)
        if node.mode == "controller":
            # nav2's lifecycle manager does not wait for a node that is there.
            pilot.prepare()
            link = stack.enter_context(connect(node.server.name, node.namespace, is_managed=True))
        else:
            # Connected first, so that other nodes are found while it compiles.
            link = stack.enter_context(connect(control.NODE, node.namespace))
            pilot.prepare()
        with stop_requests() as is_stopped:
            driver = control.ControlNode(link, pilot, node, monitors)
            driver.check_alone()
            say(
                f"Driving: {link.topic(node.scan_topic)} and {link.topic(node.pose_topic)} to "
                f"{link.topic(node.command_topic)}; Ctrl-C stops the robot and saves the drive.",
                err=True,
            )
            try:
                driver.run(is_stopped)
                if pilot.log.num_steps:
                    recording = pilot.recording(in_odometry=True)
            finally:
                # A recorder closes its file, however the drive ended.
                driver.watch.end(recording)
    say(f"Done: {pilot.finished}", err=True)
    if recording is not None:
        _save_drive(pilot, recording, settings, node, folder, options)
    times = driver.latencies
    rows = [("commands", str(times.num_commands)), ("late", str(times.num_late))]
    if len(times.scan_ms):
        rows.append(
            (
                "scan to command",
                f"{times.percentile(50):.1f} ms median, {times.percentile(99):.1f} ms p99",
            )
        )
    rows.append(("replaced by braking", str(pilot.num_replaced)))
    rows.append(("compiled while driving", str(times.num_compiled)))
    print_table(rows, has_header=False)
    if driver.gave_way:
        raise ValueError(driver.gave_way)
    if driver.gave_up:
        sys.exit(FAILED)
    if is_stopped.is_set():
        sys.exit(INTERRUPTED)


def replay_bag(bag: Path, options: dict[str, Any]) -> None:
    """Feed a recorded drive to the pilot, and write a run folder with its commands."""
    settings, node, folder = _drive_settings(options)
    if node.session is not None:
        raise ValueError(
            f"setting node.session is {short_repr(node.session)} in a replay; accepted: none, for "
            "nothing is driven"
        )
    view = cloud_view(node)
    topics = options["scan_topic"], options["pose_topic"]
    scan, pose = replay_topics(bag, *topics, is_cloud=view is not None)
    pilot = build_pilot(settings, node, is_obeyed=False)
    say("Compiling, a few seconds ...", err=True)
    pilot.prepare()
    with progress_bar("replaying", enabled=True) as advance:
        found = replay(
            bag,
            pilot,
            scan,
            pose,
            mount=control.lidar_mount(node),
            no_echo=NoEcho(node.no_echo, pilot.task.perception.resolution),
            view=view,
            further=further_lidars(
                *(node, pilot.sensor, control.lidar_mount(node)),
                *(pilot.task.perception.resolution, partial(full_topic, node)),
            ),
            on_progress=lambda seconds: advance(0.0, f"{seconds:.0f} s of {scan} and {pose}"),
        )
    if not pilot.log.num_steps:
        raise ValueError(f"{scan} and {pose} have no pose to start from; accepted: a drive")
    _save_drive(pilot, pilot.recording(in_odometry=True), settings, node, folder, options)
    say(f"{len(found.commands)} commands for {found.num_messages} messages", err=True)
    if found.num_malformed:
        say(f"{found.num_malformed} messages were left out: {found.reason}", err=True)
    if found.news:
        say(found.news, err=True)
    if found.skipped:
        say(f"{found.skipped:.1f} s without messages were skipped", err=True)


def _drive_settings(options: dict[str, Any]) -> tuple[Settings, NodeSettings, Path]:
    limit = memory_limit(options)
    file, out, session = (options.get(each) for each in ("settings_file", "out", "session"))
    entries: dict[str, object] | None = None
    if file is not None:
        entries = read_settings(file, is_trusted=options["trust"])
    elif session is not None:
        entries = read_session_settings(session)
        if entries is not None and not options["trust"]:
            check_trusted(entries, session)
    entries = {} if entries is None else entries
    if session is not None:
        assign(entries, "node.session", str(session))
    assign_all(entries, options["assignments"])
    for name in ("mode", "namespace"):
        if options.get(name) is not None:
            assign(entries, f"node.{name}", options[name])
    settings, node = make_node_settings(entries)
    # A chooser of goals gets its map from another program, and compiles when it has come.
    if node.mode != "goal":
        check_memory([settings], limit, node=node)
    folder = free_name(Path("runs") / "drive") if out is None else out
    reserve(folder, overwrite=options["overwrite"])
    return settings, node, folder


def _save_drive(
    pilot: Pilot,
    recording: ExplorationRecording,
    settings: Settings,
    node: NodeSettings,
    folder: Path,
    options: dict[str, Any],
) -> None:
    run = Run(recording, recording.metrics(seed=settings.seed))
    kept = {**read_values(settings), "node": node.model_dump(mode="json")}
    del kept["map"]
    animation, overwrite = options["animation"], options["overwrite"]
    run.save(folder, overwrite=overwrite, animation=animation, settings=kept, progress=True)
    table = pilot.log.command_table()
    write_whole(folder / COMMANDS, lambda file: file.write(table.encode()), "commands")
    print_table(run.metrics.rows(), title=str(folder), has_header=False)


def _monitors(options: dict[str, Any], folder: Path, stack: ExitStack) -> list[Monitor]:
    monitors: list[Monitor] = []
    wanted = {name: options[name] for name in VIEW}
    if any(each is not None for each in wanted.values()):
        # viser takes a second to import.
        from jaxplore.cli._view import monitors_of, open_view, tell_recording

        view = open_view(**wanted, folder=folder, began=time.time())
        stack.callback(tell_recording, view)
        stack.callback(view.close)
        monitors += monitors_of(view)
    if options["record"] is not None:
        overwrite = options["overwrite"]
        check_recording(options["record"], overwrite=overwrite, name="--record")
        recorder = McapRecorder(options["record"], overwrite=overwrite, began=time.time())
        monitors.append(recorder)
    return monitors


def choose_goals(settings: Settings, node: NodeSettings) -> None:
    """Publish goals until no place is worth a visit, or the user stops it.

    The exit code is 130 if the user stopped it, and 1 if the robot was gone for too long.
    """
    if node.goal_by == "action":
        path_action.check_nav2(import_ros())
    chooser = build_goal_chooser(settings)
    with connect(control.NODE, node.namespace) as link, stop_requests() as is_stopped:
        goals = node.goal_action if node.goal_by == "action" else node.goal_topic
        chosen = goal.GoalNode(link, chooser, node, settings.resolution)
        say(
            f"Choosing goals: {link.topic(node.map_topic)} and {link.topic(node.pose_topic)} to "
            f"{link.topic(goals)}; Ctrl-C ends it.",
            err=True,
        )
        reason = chosen.run(is_stopped)
    say(f"Done after {chosen.num_goals} goals: {reason}", err=True)
    if chosen.gave_up:
        sys.exit(FAILED)
    if is_stopped.is_set():
        sys.exit(INTERRUPTED)


def simulate_robot(options: dict[str, Any]) -> None:
    """Simulate a robot at wall-clock time, and write a run folder that judges it.

    The exit code is 130 if the user stopped it.
    """
    out, overwrite, animation = (options.pop(name) for name in ("out", "overwrite", "animation"))
    names = ("delay", "drift", "mount", "turning", "command_type", "has_map", "motors")
    own = {name: options.pop(name) for name in names}
    namespace = options.pop("namespace")
    if namespace is not None:
        namespace = check_namespace("--namespace", namespace)
    limit = memory_limit(options)
    for name in ("delay", "drift"):
        if not 0.0 <= own[name] <= _MOST[name]:
            raise ValueError(
                f"--{name} is {own[name]:g}; accepted: a number in [0, {_MOST[name]:g}]"
            )
    x, y, degrees = own["mount"]
    if not (math.hypot(x, y) <= MOST_MOUNT and math.isfinite(degrees)):
        raise ValueError(
            f"--mount is {x:g} {y:g} {degrees:g}; accepted: at most {MOST_MOUNT:g} m from the "
            "robot's centre, and a finite angle"
        )
    given = option_entries(options)
    check_memory([make_settings(given)], limit)
    entries = find_kind(given).with_start(given)
    settings = make_settings(entries)
    if isinstance(settings, Settings):
        check_no_mount(settings, "--mount and --turning")
    folder = free_name(Path("runs") / f"{folder_name(entries)}-robot") if out is None else out
    reserve(folder, overwrite=overwrite)
    experiment = build(settings)
    scenario = experiment.scenario
    if not isinstance(scenario, ExplorationScenario):
        raise ValueError("the task is a path; accepted: a map")
    show_starts({"": given}, {"": entries})
    simulated = SimulatedRobot(
        scenario,
        jax.random.key(settings.seed),
        delay=own["delay"],
        drift=own["drift"],
        mount=(x, y, math.radians(degrees)),
        is_turning=own["turning"],
        motors=None if own["motors"] is None else read_motors(own["motors"]),
    )
    with connect(robot.NODE, namespace) as link:
        say("Compiling, a few seconds ...", err=True)
        simulated.prepare()
        node = robot.RobotNode(
            link, simulated, command_type=own["command_type"], has_map=own["has_map"]
        )
        node.check_alone()
        topics = (robot.SCAN_TOPIC, robot.ODOMETRY_TOPIC, robot.COMMAND_TOPIC)
        say(f"The robot is ready: {', '.join(map(link.topic, topics))}; Ctrl-C ends it.", err=True)
        with (
            stop_requests() as is_stopped,
            progress_bar("simulating", enabled=True) as advance,
        ):
            is_interrupted = node.run(is_stopped, settings.time_limit, advance)
    recording = simulated.recording(is_interrupted=is_interrupted)
    run = Run(recording, recording.metrics(seed=settings.seed))
    run.save(
        folder,
        overwrite=overwrite,
        animation=animation,
        settings=read_values(settings),
        progress=True,
    )
    print_table(run.metrics.rows(), title=str(folder), has_header=False)
    if is_interrupted:
        sys.exit(INTERRUPTED)
