"""Recordings as MCAP, read with the reader of the format and the schemas in the file."""

import dataclasses
import errno
import io
import json
import os
import sys
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

import jaxplore as jx
from jaxplore.control.mppi import MPPI
from jaxplore.recorder import McapRecorder, SwitchedRecorder
from jaxplore.recorder.recorder import RecordingWarning
from jaxplore.report.exploration.data import ExplorationRecord
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.report.following.data import PathRecord
from jaxplore.report.recording import Recording
from jaxplore.report.volume.data import VolumeFrame, VolumeRecord
from jaxplore.report.volume.recording import VolumeRecording
from jaxplore.simulation.monitor import Requests, Update
from jaxplore.topics.messages import even_angles

COMMON = ["/command", "/metrics", "/objects", "/plan", "/pose"]
COMMON += ["/rollout_costs", "/rollouts", "/state", "/tf"]
EXPLORATION = sorted([*COMMON, "/belief", "/cost_terms", "/information", "/scan", "/world"])


class Message(NamedTuple):
    topic: str
    schema: str
    time: float
    content: Any


@pytest.fixture(scope="module")
def controller() -> MPPI:
    robot = jx.DifferentialDrive()
    return MPPI(robot, jx.ControlCost(), horizon=2, num_samples=2, noise_std=[1.0, 1.0])


def record(recording: Recording, path: Path, controller: MPPI, **given: Any) -> McapRecorder:
    """Show a recorder a run that is known already: its updates end with each frame but the last."""
    recorder = McapRecorder(path, **given)
    first, *others = recording.frames
    blank = jax.tree.map(lambda rows: rows[:0], recording.records)
    recorder.begin(dataclasses.replace(recording, records=blank, frames=(first,)), controller)
    done = first.step
    for frame in others[:-1]:
        rows = jax.tree.map(lambda each, a=done, b=frame.step: each[a:b], recording.records)
        recorder.show(Update(frame, rows, recording.time[done + 1 : frame.step + 1], "50 %"))
        done = frame.step
    recorder.end(recording)
    return recorder


def read(path: Path) -> list[Message]:
    """Decode all messages in the order of the file."""
    kinds: dict[int, Any] = {}
    found = []
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert {each.compression for each in summary.chunk_indexes} == {"zstd"}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if schema.encoding == "protobuf" and schema.id not in kinds:
                files = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
                pool = descriptor_pool.DescriptorPool()
                for each in files.file:
                    pool.Add(each)
                kind = pool.FindMessageTypeByName(schema.name)
                kinds[schema.id] = message_factory.GetMessageClass(kind)
            decode = kinds[schema.id].FromString if schema.id in kinds else json.loads
            content = decode(message.data)
            found.append(Message(channel.topic, schema.name, message.log_time * 1e-9, content))
        counted = summary.statistics.channel_message_counts
    assert sum(counted.values()) == len(found)
    return found


def of(messages: list[Message], topic: str) -> list[Message]:
    return [each for each in messages if each.topic == topic]


def grid_values(grid: Any, name: str, dtype: Any) -> np.ndarray:
    cells = np.frombuffer(grid.data, np.uint8).reshape(-1, grid.column_count, grid.cell_stride)
    (offset,) = (field.offset for field in grid.fields if field.name == name)
    size = np.dtype(dtype).itemsize
    return np.ascontiguousarray(cells[..., offset : offset + size]).view(dtype)[..., 0]


def yaw_of(rotation: Any) -> float:
    return 2.0 * np.arctan2(rotation.z, rotation.w)


def test_an_exploration_is_recorded_as_it_was(vehicle, controller, tmp_path: Path) -> None:
    recorder = record(vehicle, tmp_path / "run.mcap", controller)
    assert recorder.failure is None
    assert [each.name for each in tmp_path.iterdir()] == ["run.mcap"]
    messages = read(tmp_path / "run.mcap")
    assert sorted({each.topic for each in messages}) == EXPLORATION
    times = [each.time for each in messages]
    assert times == sorted(times)
    assert (times[0], times[-1]) == (0.0, vehicle.time[-1])
    counts = {topic: len(of(messages, topic)) for topic in EXPLORATION}
    steps, frames = vehicle.num_steps, len(vehicle.frames)
    assert counts["/command"] == counts["/state"] == steps
    assert counts["/metrics"] == frames - 1
    assert counts["/world"] == 1
    # Frames are 1.5 s apart or more: each has its maps.
    assert counts["/belief"] == counts["/information"] == counts["/tf"] == counts["/scan"] == frames

    for i, each in enumerate(of(messages, "/command")):
        assert each.time == pytest.approx(vehicle.time[i + 1])
        assert list(each.content) == ["a", "alpha"]
        np.testing.assert_array_equal(list(each.content.values()), vehicle.records.control[i])
    for i, each in enumerate(of(messages, "/state")):
        assert each.content == dict(
            zip(vehicle.state_names, vehicle.records.state[i].tolist(), strict=True)
        )
    last = of(messages, "/metrics")[-1].content
    assert np.float32(last["coverage"]) == vehicle.records.coverage[-1]
    # A flag counts if it was set since the last message.
    assert last["is_untraversable"] == 1.0
    assert "text" not in last
    assert of(messages, "/metrics")[0].content["text"] == "50 %"
    assert of(messages, "/cost_terms")[0].content == {"ControlCost": 1.0}

    for frame, shown in zip(vehicle.frames, of(messages, "/belief"), strict=True):
        assert shown.schema == "foxglove.Grid"
        assert shown.content.timestamp.seconds + 1e-9 * shown.content.timestamp.nanos == frame.time
        values = grid_values(shown.content, "probability", np.uint8)
        np.testing.assert_array_equal(values, frame.probability)
    for frame, shown in zip(vehicle.frames, of(messages, "/information"), strict=True):
        values = grid_values(shown.content, "information", np.float32)
        np.testing.assert_array_equal(values, np.float32(frame.information))
        assert shown.content.cell_size.x == pytest.approx(vehicle.field_resolution)
    (world,) = of(messages, "/world")
    values = grid_values(world.content, "probability", np.uint8)
    np.testing.assert_array_equal(values, np.round(255 * vehicle.world))

    for frame, scan, place in zip(
        vehicle.frames, of(messages, "/scan"), of(messages, "/tf"), strict=True
    ):
        ranges = np.array(scan.content.ranges)
        here = frame.state[:2].astype(float)
        np.testing.assert_allclose(ranges, np.hypot(*(frame.scan - here).T), atol=1e-6)
        assert scan.content.frame_id == place.content.child_frame_id == "base_link"
        # What Foxglove draws: the ends of the beams in the robot's frame, moved to the map's.
        angles = np.linspace(scan.content.start_angle, scan.content.end_angle, len(ranges))
        angles += yaw_of(place.content.rotation)
        ends = np.stack([np.cos(angles), np.sin(angles)], -1) * ranges[:, None]
        ends += [place.content.translation.x, place.content.translation.y]
        np.testing.assert_allclose(ends, frame.scan, atol=1e-4)

    objects = {each.id: each for each in of(messages, "/objects")[-1].content.entities}
    assert len(objects["robot"].triangles[0].points) == 6
    frame = vehicle.frames[-1]
    movers = [
        (each.pose.position.x, each.pose.position.y, 0.5 * each.size.x)
        for each in objects["moving obstacles"].cylinders
    ]
    np.testing.assert_allclose(movers, np.column_stack([frame.movers, vehicle.mover_radii]))
    assert len(objects["parts"].cylinders) == len(vehicle.parts["targets"].places)
    plan = {each.id: each for each in of(messages, "/plan")[-1].content.entities}
    points = [(point.x, point.y) for point in plan["plan"].lines[0].points]
    np.testing.assert_array_equal(np.float32(points), frame.plan)
    (rollouts,) = of(messages, "/rollouts")[-1].content.entities
    best = rollouts.lines[-1]
    points = np.float32([(point.x, point.y) for point in best.points])
    np.testing.assert_array_equal(points, frame.samples[np.argmax(frame.weights)])
    # In the order of the lines: all six of the frame, by weight.
    order = np.argsort(frame.weights, kind="stable")
    costs = of(messages, "/rollout_costs")[-1].content
    assert list(costs) == ["weight", "total cost", "ControlCost", "ObstacleCost"]
    np.testing.assert_array_equal(costs["ControlCost"], 1.0 + order)
    obstacle = [0.0, 0.5, None, 0.0, 0.5, None]
    assert costs["ObstacleCost"] == [obstacle[i] for i in order]
    # The rollouts of great weight are as opaque as in the animation.
    opacity = sorted(round(255 * line.color.a) for line in rollouts.lines)
    assert opacity == [70, 70, 70, 235, 235, 235]


def test_a_grid_lies_where_the_map_does(make_recording, controller, tmp_path: Path) -> None:
    run = make_recording([(0.5, 1.0), (0.7, 1.0)], [0.5], origin=(1.0, -2.0, 0.5))
    record(run, tmp_path / "run.mcap", controller)
    (belief, *_) = of(read(tmp_path / "run.mcap"), "/belief")
    pose = belief.content.pose
    frame = jx.OccupancyGrid(run.belief, run.resolution, run.origin).frame
    at = np.array([3, 7])
    # The centre of a cell by the schema of the message: from the corner, x along the columns.
    cell = (at[::-1] + 0.5) * belief.content.cell_size.x
    yaw = yaw_of(pose.orientation)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    found = turn @ cell + [pose.position.x, pose.position.y]
    np.testing.assert_allclose(found, np.asarray(frame.cell_centre(jnp.asarray(at))), atol=1e-5)
    assert belief.content.row_stride == belief.content.column_count * belief.content.cell_stride


def test_colours_are_those_of_the_animation(recording, controller, tmp_path: Path) -> None:
    record(recording, tmp_path / "run.mcap", controller)
    messages = read(tmp_path / "run.mcap")
    belief, information = (of(messages, name)[-1].content for name in ("/belief", "/information"))
    colours = np.stack([grid_values(belief, name, np.uint8) for name in ("red", "green", "blue")])
    level = recording.frames[-1].probability
    np.testing.assert_array_equal(colours[:, level == 0].T[0], (252, 252, 250))
    np.testing.assert_array_equal(colours[:, level == 255].T[0], (43, 48, 58))
    # Information is shown in free cells only, the more the stronger.
    alpha = grid_values(information, "alpha", np.uint8)
    free = level[1::2, 1::2] < 64
    assert not alpha[~free].any()
    field = recording.frames[-1].information
    expected = 0.75 * 255 * np.minimum(field / np.percentile(field, 98), 1.0)
    np.testing.assert_allclose(alpha[free], expected[free], atol=1.0)


def test_a_following_is_recorded_with_its_course(ring, controller, tmp_path: Path) -> None:
    record(ring, tmp_path / "run.mcap", controller)
    messages = read(tmp_path / "run.mcap")
    assert sorted({each.topic for each in messages}) == sorted([*COMMON, "/course"])
    times = [each.time for each in messages]
    assert times == sorted(times)
    (course,) = of(messages, "/course")[0].content.entities
    lines = [[(point.x, point.y) for point in each.points] for each in course.lines]
    np.testing.assert_array_equal(np.float32(lines), np.stack([ring.centre, *ring.edges]))
    objects = {each.id: each for each in of(messages, "/objects")[-1].content.entities}
    drawn = {
        tuple(np.round([each.pose.position.x, each.pose.position.y, 0.5 * each.size.x], 4).tolist())
        for each in objects["obstacles"].cylinders
    }
    # Polygons have a disc at each of their corners.
    assert drawn == {
        tuple(np.round([x, y, radius], 4).tolist())
        for places, radius in zip(ring.frames[-1].corners, ring.obstacle_radii, strict=True)
        for x, y in places
    }
    last = of(messages, "/metrics")[-1].content
    assert np.float32(last["progress"]) == ring.records.progress[-1]
    # The robot of the controller has two controls, that of the recording three.
    assert list(of(messages, "/command")[0].content) == ["u0", "u1", "u2"]


def test_a_volume_is_recorded_with_its_voxels(recording, controller, tmp_path: Path) -> None:
    shape, side, origin = (4, 5, 6), 0.5, np.array([1.0, 2.0, 0.5])
    occupied = np.random.default_rng(0).random(shape) < 0.4
    robot = jx.Quadrotor()
    states = np.zeros((3, 13), np.float32)
    # A heading of 0.8 rad, with z down.
    states[:] = robot.at_pose(1.5, 2.5, 0.8, -1.0)
    rows, flags = np.zeros(3, np.float32), np.zeros(3, bool)
    records = VolumeRecord(states, np.ones((3, 4), np.float32), rows, rows, flags, rows, flags)
    plan = np.array([[1.5, 2.5, 1.0], [2.0, 2.5, 1.2]], np.float32)
    frames = tuple(
        VolumeFrame(
            step=step,
            time=step * 0.05,
            state=states[0],
            level=np.zeros((5, 6), np.uint8),
            upright=np.zeros((4, 6), np.uint8),
            voxels=np.packbits(occupied.reshape(-1)),
            plan=plan,
        )
        for step in (0, 3)
    )
    run = VolumeRecording(
        records=records,
        frames=frames,
        timing=recording.timing,
        control_period=0.05,
        is_interrupted=False,
        world=occupied,
        belief=np.where(occupied, 2, 1).astype(np.uint8),
        observable=~occupied,
        resolution=side,
        origin=origin,
        start=states[0],
        state_names=robot.state_names,
        initial_coverage=0.0,
        target_coverage=0.9,
        robot_radius=0.3,
    )
    record(run, tmp_path / "run.mcap", controller)
    messages = read(tmp_path / "run.mcap")
    topics = {"/command", "/metrics", "/plan", "/pose", "/state", "/tf", "/voxels"}
    assert {each.topic for each in messages} == topics
    at = of(messages, "/pose")[-1].content.pose
    np.testing.assert_allclose([at.position.x, at.position.y, at.position.z], [1.5, 2.5, 1.0])
    assert yaw_of(at.orientation) == pytest.approx(0.8, abs=1e-6)
    (entity,) = of(messages, "/plan")[-1].content.entities
    drawn = [[point.x, point.y, point.z] for point in entity.lines[0].points]
    np.testing.assert_allclose(drawn, plan)
    cloud = of(messages, "/voxels")[0].content
    points = np.frombuffer(cloud.data, np.float32).reshape(-1, 3)
    # The two upper layers are the ceiling.
    wanted = (np.argwhere(occupied[:2])[:, ::-1] + 0.5) * side + origin
    np.testing.assert_allclose(points, wanted, rtol=1e-6)


def test_a_fleet_is_recorded_with_each_robot_under_its_name(
    fleet_run, controller, tmp_path: Path, make_search
) -> None:
    steps, targets = fleet_run.num_steps, np.array([[0.5, 0.2], [1.0, 0.7]])
    run = make_search(fleet_run, targets, np.ones(steps), lambda step: np.array([step > 0, False]))
    frames = run.frames
    recorder = record(run, tmp_path / "run.mcap", controller)
    assert recorder.failure is None
    messages = read(tmp_path / "run.mcap")
    own = ("pose", "plan", "trail", "metrics", "belief")
    topics = {f"/{name}/{topic}" for name in ("robot1", "robot2") for topic in own}
    common = {"/belief", "/command", "/metrics", "/objects", "/state", "/tf", "/world"}
    assert {each.topic for each in messages} == topics | common
    for number, name in enumerate(("robot1", "robot2")):
        poses = of(messages, f"/{name}/pose")
        found = [
            (at.position.x, at.position.y, yaw_of(at.orientation))
            for at in (each.content.pose for each in poses)
        ]
        np.testing.assert_allclose(
            found,
            [(*run.places(frame)[number], frame.headings[number]) for frame in frames],
            atol=1e-6,
        )
        frame_id = f"{name}/base_link"
        children = [each.content.child_frame_id for each in of(messages, "/tf")]
        assert children.count(frame_id) == len(frames)
        (trail,) = of(messages, f"/{name}/trail")[-1].content.entities
        drawn = [(point.x, point.y) for point in trail.lines[0].points]
        np.testing.assert_array_equal(np.float32(drawn), np.float32(run.trails[number]))
        (plan,) = of(messages, f"/{name}/plan")[-1].content.entities
        drawn = [(point.x, point.y) for point in plan.lines[0].points]
        np.testing.assert_array_equal(np.float32(drawn), frames[-1].plans[number])
        (grid,) = of(messages, f"/{name}/belief")
        levels = grid_values(grid.content, "probability", np.uint8)
        np.testing.assert_array_equal(levels, run.parts["team"].beliefs[number])
        assert grid.time == pytest.approx(steps * 0.1)
        entity = {each.id: each for each in of(messages, "/objects")[-1].content.entities}[name]
        assert entity.frame_id == frame_id
        assert entity.cylinders[0].size.x == pytest.approx(2.0 * run.radii[number])
    first, second = (of(messages, f"/{name}/metrics") for name in ("robot1", "robot2"))
    # A collision between two messages is in the next of them.
    assert [each.content["is_collision"] for each in first] == [1.0, 0.0]
    assert [each.content["is_collision"] for each in second] == [0.0, 0.0]
    assert np.float32(second[-1].content["coverage"]) == run.records.parts["team"].coverages[-1, 1]
    linked = [
        {each.id: each for each in message.content.entities}["links"].lines
        for message in of(messages, "/objects")
    ]
    assert [len(lines) for lines in linked] == [0, 1, 1]
    marks = {each.id: each for each in of(messages, "/objects")[-1].content.entities}["parts"]
    places = [(each.pose.position.x, each.pose.position.y) for each in marks.cylinders]
    np.testing.assert_allclose(places, targets)
    assert marks.cylinders[0].color != marks.cylinders[1].color
    together = of(messages, "/belief")[-1].content
    shown = grid_values(together, "probability", np.uint8)
    np.testing.assert_array_equal(shown, frames[-1].probability)


def test_values_that_json_lacks_are_left_out(make_straight, controller, tmp_path: Path) -> None:
    record(make_straight(), tmp_path / "run.mcap", controller)
    last = of(read(tmp_path / "run.mcap"), "/metrics")[-1].content
    assert "progress" in last
    assert not {"room", "gap"} & set(last)


def test_names_are_data(vehicle, controller, tmp_path: Path) -> None:
    name = 'x"}, <script>\n"/tf'
    frames = [dataclasses.replace(each, terms={name: 2.0}) for each in vehicle.frames]
    run = dataclasses.replace(vehicle, frames=tuple(frames))
    record(run, tmp_path / "run.mcap", controller)
    messages = read(tmp_path / "run.mcap")
    assert of(messages, "/cost_terms")[0].content == {name: 2.0}
    assert sorted({each.topic for each in messages}) == EXPLORATION


def test_a_robot_in_real_time_has_no_true_world(recording, controller, tmp_path: Path) -> None:
    real = dataclasses.replace(recording, world=np.full_like(recording.world, 0.5))
    record(real, tmp_path / "run.mcap", controller, began=1_700_000_000.5)
    messages = read(tmp_path / "run.mcap")
    assert not of(messages, "/world")
    assert messages[0].time == pytest.approx(1_700_000_000.5, abs=1e-6)
    assert messages[-1].time == pytest.approx(1_700_000_005.5, abs=1e-6)


def test_maps_are_half_a_second_apart(make_recording, controller, tmp_path: Path) -> None:
    positions = [(0.5 + 0.01 * k, 1.0) for k in range(41)]
    run = make_recording(positions, [0.5] * 40, num_frames=41, control_period=0.1)
    frames = [dataclasses.replace(each, time=0.1 * each.step) for each in run.frames]
    record(dataclasses.replace(run, frames=tuple(frames)), tmp_path / "run.mcap", controller)
    messages = read(tmp_path / "run.mcap")
    assert len(of(messages, "/tf")) == 41
    np.testing.assert_allclose(
        [each.time for each in of(messages, "/belief")], 0.5 * np.arange(9), atol=1e-9
    )


def test_a_scan_of_uneven_beams_is_recorded_as_points(
    recording: ExplorationRecording, controller, tmp_path: Path
) -> None:
    frames = [dataclasses.replace(each, scan=each.scan[:5] ** 2) for each in recording.frames]
    record(dataclasses.replace(recording, frames=tuple(frames)), tmp_path / "run.mcap", controller)
    messages = read(tmp_path / "run.mcap")
    assert not of(messages, "/scan")
    points = of(messages, "/points")[-1].content
    ends = np.frombuffer(points.data, np.float32).reshape(-1, 3)
    np.testing.assert_array_equal(ends[:, :2], frames[-1].scan)


def test_angles_of_a_fan_are_found_from_some_of_its_beams() -> None:
    bearings = np.linspace(-2.0, 2.0, 9) + 3.0
    wrapped = np.angle(np.exp(1j * bearings))
    wrapped[[0, 4]] = np.nan
    first, last = even_angles(wrapped)
    assert last - first == pytest.approx(4.0)
    assert np.exp(1j * first) == pytest.approx(np.exp(1j * bearings[0]))
    wrapped[2] += 0.1
    assert even_angles(wrapped) is None
    assert even_angles(np.array([np.nan, 1.0])) is None


def test_a_run_that_fails_leaves_no_file(recording, controller, tmp_path: Path) -> None:
    recorder = McapRecorder(tmp_path / "run.mcap")
    recorder.begin(recording, controller)
    assert len(list(tmp_path.iterdir())) == 1
    assert not (tmp_path / "run.mcap").exists()
    recorder.end(None)
    recorder.end(None)
    assert not list(tmp_path.iterdir())


def drive(recorder: SwitchedRecorder, run: Recording, controller: MPPI, **acts: Any) -> None:
    """Show a run step by step, as a loop does; acts come before the update after so many steps."""
    first, shown = run.frames[0], 0
    blank = jax.tree.map(lambda rows: rows[:0], run.records)
    recorder.begin(dataclasses.replace(run, records=blank, frames=(first,)), controller)
    for step in range(1, run.num_steps + 1):
        acts.get(f"s{step}", lambda: None)()
        if recorder.is_due((step - shown) * run.control_period, 0.0):
            rows = jax.tree.map(lambda each, a=shown, b=step: each[a:b], run.records)
            frame = dataclasses.replace(first, step=step, time=run.time[step].item())
            recorder.show(Update(frame, rows, run.time[shown + 1 : step + 1], "on"))
            shown = step
        assert recorder.requests() == Requests()


def test_parts_of_a_run_are_recorded_while_it_goes_on(ring, controller, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "runs"
    recorder = SwitchedRecorder(folder, name="ring")
    told: list[tuple[bool, str]] = []
    recorder.on_change = lambda: told.append((recorder.is_on, recorder.message))
    with pytest.raises(ValueError, match="no run goes on; accepted"):
        recorder.start()
    drive(
        recorder,
        ring,
        controller,
        s10=recorder.start,
        s15=recorder.stop,
        s18=recorder.start,
    )
    (hidden,) = set(folder.iterdir()) - set(folder.glob("*.mcap"))
    recorder.end(ring)
    assert not hidden.exists()
    recorder.stop()
    parts = sorted(folder.iterdir(), key=lambda each: (len(each.name), each.name))
    # Both begin in the same second, or not.
    assert [each.name.startswith("ring-20") for each in parts] == [True, True]
    assert recorder.path == parts[-1]
    assert [is_on for is_on, _ in told][-1] is False
    assert told[0] == (True, "Recording starts with the next step.")
    assert (True, f"Recording to {parts[0]}") in told
    assert (False, f"Recorded to {parts[0]}") in told
    assert told[-1] == (False, f"Recorded to {parts[1]}")
    # A recording is whole: what stays the same is at its beginning, and the steps follow.
    for part, steps in zip(parts, (range(11, 16), range(19, 41)), strict=True):
        messages = read(part)
        assert sorted({each.topic for each in messages}) == sorted([*COMMON, "/course"])
        times = [each.time for each in messages]
        assert times == sorted(times)
        (course,) = of(messages, "/course")
        assert course.time == of(messages, "/tf")[0].time == ring.time[steps[0] - 1]
        found = [each.time for each in of(messages, "/state")]
        np.testing.assert_allclose(found, ring.time[list(steps)])
        rows = [list(each.content.values()) for each in of(messages, "/state")]
        np.testing.assert_array_equal(rows, ring.records.state[np.array(steps) - 1])


def test_a_run_that_fails_ends_a_switched_recording(ring, controller, tmp_path: Path) -> None:
    recorder = SwitchedRecorder(tmp_path)
    drive(recorder, ring, controller, s10=recorder.start)
    recorder.end(None)
    (part,) = tmp_path.iterdir()
    assert len(of(read(part), "/state")) == ring.num_steps - 10
    assert not recorder.is_on


def test_a_recording_that_cannot_begin_is_one_line_and_the_run_goes_on(
    ring, controller, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    recorder = SwitchedRecorder(tmp_path / "file")
    drive(recorder, ring, controller, s10=recorder.start)
    assert "cannot be written" in recorder.message
    assert "\n" not in recorder.message
    assert not recorder.is_on
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(ValueError, match=r"foxglove is not installed; accepted: pip install"):
        recorder.start()
    assert recorder.longest_chunk(1.0) == 0.5
    with pytest.raises(ValueError, match="name is 'a/b'; accepted: the first part"):
        SwitchedRecorder(name="a/b")


def test_a_full_disk_costs_the_recording_and_not_the_run(
    recording, controller, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "open", lambda path, mode: _Small(path, mode.replace("b", "")))
    with pytest.warns(RecordingWarning, match="cannot be written: No space left") as caught:
        recorder = record(recording, tmp_path / "run.mcap", controller)
    assert len(caught) == 1
    assert recorder.failure is not None
    assert "\n" not in recorder.failure
    assert not list(tmp_path.iterdir())


class _Small(io.FileIO):
    """A file on a disk with room for a kilobyte."""

    def write(self, data: Any) -> int:
        if self.tell() + len(data) > 1000:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(data)


def test_what_cannot_be_recorded_to_is_one_line(tmp_path: Path) -> None:
    for name, reason in (
        ("run.bag", "accepted: a file that ends in .mcap"),
        ("there/run.mcap", "accepted: a file in a folder that exists"),
        ("taken.mcap", "which exists; accepted"),
        ("folder.mcap", "which exists; accepted"),
    ):
        (tmp_path / "taken.mcap").write_text("")
        (tmp_path / "folder.mcap").mkdir(exist_ok=True)
        with pytest.raises(ValueError, match=reason) as caught:
            McapRecorder(tmp_path / name, overwrite=name.startswith("folder"))
        assert "\n" not in str(caught.value)


def test_a_recording_that_is_replaced_stays_until_the_end(
    recording, controller, tmp_path: Path
) -> None:
    (tmp_path / "run.mcap").write_text("former")
    recorder = McapRecorder(tmp_path / "run.mcap", overwrite=True)
    recorder.begin(recording, controller)
    assert (tmp_path / "run.mcap").read_text() == "former"
    recorder.end(None)
    assert (tmp_path / "run.mcap").read_text() == "former"
    record(recording, tmp_path / "run.mcap", controller, overwrite=True)
    assert of(read(tmp_path / "run.mcap"), "/tf")


def test_the_layout_shows_topics_and_values_that_are_recorded() -> None:
    file = Path(__file__).parents[2] / "docs" / "foxglove_layout.json"
    panels = json.loads(file.read_text())["configById"]
    assert set(panels["3D!scene"]["topics"]) <= {*EXPLORATION, "/course", "/points"}
    robots = (jx.DifferentialDrive, jx.Ackermann)
    known = {
        "/metrics": {*ExplorationRecord._fields, *PathRecord._fields},
        "/state": {name for robot in robots for name in robot.state_names},
        "/command": {name for robot in robots for name in robot.control_names},
    }
    paths = [each["value"] for panel in panels.values() for each in panel.get("paths", [])]
    assert len(paths) > 5
    for path in paths:
        topic, _, name = path.partition(".")
        assert name in known[topic]
