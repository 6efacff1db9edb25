import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from jaxplore.control.base import Members
from jaxplore.simulation.record import Record
from jaxplore.simulation.recording import Frame, Recording, Timing

PERIOD = 0.5
NAMES = ("x", "y", "yaw", "v", "omega")


def turned(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Points given along the axes of a pose, in the world."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, -sin], [sin, cos]])
    return (np.asarray(points) @ turn.T + pose[:2]).astype(np.float32)


@pytest.fixture
def make_recording() -> Callable[..., Recording]:
    """A run along given positions in a walled room, its map growing from left to right."""

    def make(
        positions: list[tuple[float, float]],
        coverage: list[float],
        *,
        shape: tuple[int, int] = (20, 30),
        origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
        num_frames: int = 4,
        **changes: object,
    ) -> Recording:
        steps, resolution = len(positions) - 1, 0.1
        pose = np.array(origin, np.float32)
        route = turned(np.array(positions, float).reshape(-1, 2), pose)
        states = np.zeros((steps + 1, 5), np.float32)
        states[:, :2], states[:, 2] = route, pose[2]
        world = np.full(shape, 0.5, np.float32)
        reachable = np.zeros(shape, bool)
        reachable[1:-1, 1:-1] = True
        if min(shape) == 1:
            reachable[:] = True
        world[:] = np.where(reachable, 0.0, 1.0)
        rows, columns = -(-shape[0] // 2), -(-shape[1] // 2)
        frames = []
        for step in np.unique(np.linspace(0, steps, num_frames).round().astype(int)):
            here = route[step]
            angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
            ring = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
            seen = (np.arange(shape[1]) / shape[1] <= (step + 1) / (steps + 1)) & (world < 2)
            ahead = np.linspace(0.0, 1.0, 5)[None, :, None] * ring[:6, None]
            frames.append(
                Frame(
                    step=int(step),
                    time=float(step * PERIOD),
                    state=states[step],
                    probability=np.where(seen, 255 * world, 128).astype(np.uint8),
                    information=np.linspace(0.0, 9.0, rows * columns).reshape(rows, columns),
                    scan=(here + ring).astype(np.float32),
                    samples=(here + ahead).astype(np.float32),
                    weights=np.array([0.5, 0.1, 1e-3, 1e-9, 0.0, 0.3], np.float32),
                    plan=(here + ahead[0]).astype(np.float32),
                    heading=float(pose[2]),
                    reference=np.zeros((0, 2), np.float32),
                    movers=np.zeros((0, 2), np.float32),
                    terms={"ControlCost": 1.0},
                )
            )
        records = Record(
            state=states[1:],
            control=np.zeros((steps, 2), np.float32),
            coverage=np.array(coverage, np.float32),
            entropy=np.linspace(90.0, 10.0, steps).astype(np.float32),
            unknown=np.linspace(0.9, 0.1, steps).astype(np.float32),
            clearance=np.full(steps, 0.3, np.float32),
            is_collision=np.zeros(steps, bool),
            is_untraversable=np.zeros(steps, bool),
            effective_sample_size=np.full(steps, 8.0, np.float32),
            is_finite=np.ones(steps, bool),
            is_faulty=np.zeros(steps, bool),
            targets_seen=np.zeros(steps, np.int32),
            mean_idleness=np.zeros(steps, np.float32),
            worst_idleness=np.zeros(steps, np.float32),
            members=None,
        )
        covered = np.flatnonzero(records.coverage >= np.float32(0.99))
        recording = Recording(
            records=records,
            frames=tuple(frames),
            timing=Timing(2.0, 1.0, 100, np.array([0.01, 0.02, 0.03])),
            control_period=PERIOD,
            world=world,
            belief=np.where(seen, world, 0.5).astype(np.float32),
            reachable=reachable,
            origin=pose,
            resolution=resolution,
            field_origin=pose,
            field_resolution=2.0 * resolution,
            start=states[0],
            initial_coverage=0.01,
            initial_entropy=100.0,
            initial_unknown=1.0,
            goal=None,
            finished_step=int(covered[0]) + 1 if covered.size else None,
            control_half_range=np.array([1.0, 2.0], np.float32),
            state_names=NAMES,
            robot_radius=0.2,
            target_coverage=float(np.float32(0.99)),
            is_interrupted=False,
            footprint=np.zeros((0, 2)),
            targets=np.zeros((0, 2), np.float32),
            elevation=None,
            traversable=None,
            idleness=None,
            mover_radii=np.zeros(0),
            member_names=(),
        )
        return dataclasses.replace(recording, **changes)

    return make


@pytest.fixture
def recording(make_recording: Callable[..., Recording]) -> Recording:
    """Ten steps of 0.2 m to the right, all of the room covered in the end."""
    positions = [(0.5 + 0.2 * k, 1.0) for k in range(11)]
    return make_recording(positions, [0.1, 0.2, 0.3, 0.5, 0.6, 0.7, 0.9, 0.95, 0.97, 0.99])


@pytest.fixture
def no_step(make_recording: Callable[..., Recording]) -> Recording:
    """A run that ended before its first step."""
    return make_recording([(0.5, 1.0)], [])


CORNERS = np.array([[0.4, 0.15], [-0.2, 0.15], [-0.2, -0.15], [0.4, -0.15]])
"""Of a robot that is 0.6 m long and 0.3 m wide, in its own frame [m]."""
MEMBERS = ("bold", "careful", "slow")


def ground_vehicle(recording: Recording) -> Recording:
    """The same run with everything that a ground vehicle's may hold besides."""
    steps, (rows, columns) = recording.num_steps, recording.world.shape
    row, column = np.mgrid[:rows, :columns]
    pose, resolution = recording.origin, recording.resolution
    width, height = columns * resolution, rows * resolution
    targets = turned(np.array([[0.2, 0.8], [0.5, 0.3], [0.9, 0.6]]) * (width, height), pose)
    frames = []
    for frame in recording.frames:
        share = frame.step / max(steps, 1)
        movers = turned(np.array([[0.3 + 0.3 * share, 0.75], [0.7, 0.25]]) * (width, height), pose)
        frames.append(dataclasses.replace(frame, movers=movers))
    k = np.arange(steps, dtype=np.float32)
    never = np.full(steps, np.inf, np.float32)

    def each(*values: object) -> np.ndarray:
        return np.stack([np.broadcast_to(value, steps) for value in values], -1).astype(np.float32)

    members = Members(
        controls=np.zeros((steps, 3, 2), np.float32),
        costs=each(k, 2.0 * k, never),
        uncertainties=each(0.125, 0.25, np.where(k < 1, np.nan, 0.5)),
        effective_sample_sizes=each(1.0 + k, 10.0, 0.0),
        shares=each(0.25 + 0.05 * (k % 2), 0.25 - 0.05 * (k % 2), 0.5),
        diversity=np.full(steps, 0.25, np.float32),
        is_replaced=k % 5 == 0,
    )
    records = recording.records._replace(
        targets_seen=np.minimum(np.arange(steps) // 3, 3).astype(np.int32),
        is_untraversable=k >= steps - 2,
        mean_idleness=k,
        worst_idleness=np.where(k < steps // 2, 20.0, 10.0 - np.abs(k - 6.0)).astype(np.float32),
        members=members,
    )
    traversable = (column < 0.6 * columns) | (row < 0.6 * rows)
    idleness = np.where(column < columns / 2, 0.1 * column, np.inf).astype(np.float32)
    return dataclasses.replace(
        recording,
        records=records,
        frames=tuple(frames),
        target_coverage=None,
        finished_step=None,
        footprint=CORNERS,
        targets=targets,
        elevation=(0.05 * column + 0.02 * row).astype(np.float32),
        traversable=traversable,
        idleness=idleness,
        mover_radii=np.array([0.2, 0.3], np.float32),
        member_names=MEMBERS,
    )


@pytest.fixture
def make_vehicle() -> Callable[[Recording], Recording]:
    """Add ground, targets, movers, a watch, members and a rectangle to a run."""
    return ground_vehicle


@pytest.fixture
def vehicle(recording: Recording) -> Recording:
    """A run of ten steps with ground, targets, movers, a watch, members and a rectangle."""
    return ground_vehicle(recording)
