import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

from jaxplore.control.base import Members
from jaxplore.parts.targets.report import TargetRecord, TargetReport
from jaxplore.parts.watch.report import WatchRecord, WatchReport
from jaxplore.parts.wheels.report import WheelRecord, WheelReport
from jaxplore.report.compute import Timing
from jaxplore.report.exploration.data import ExplorationFrame, ExplorationRecord
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.report.exploration.team import TeamRecord, TeamReport
from jaxplore.report.following.data import PathFrame, PathRecord
from jaxplore.report.following.recording import PathRecording

PERIOD = 0.5
NAMES = ("x", "y", "yaw", "v", "omega")
SAMPLE_TERMS = {
    "ControlCost": np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], np.float32),
    "ObstacleCost": np.array([0.0, 0.5, np.inf, 0.0, 0.5, np.nan], np.float32),
}
"""What the six rollouts of a frame cost."""


def turned(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Points given along the axes of a pose, in the world."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, -sin], [sin, cos]])
    return (np.asarray(points) @ turn.T + pose[:2]).astype(np.float32)


@pytest.fixture
def check_margins(tmp_path: Path) -> Callable[[Figure], None]:
    """Return what checks that everything is inside the picture of a figure."""

    def check(figure: Figure) -> None:
        figure.savefig(tmp_path / "picture.png", dpi=60)
        with Image.open(tmp_path / "picture.png") as image:
            picture = np.asarray(image.convert("L"))
        assert min(picture.shape) > 100
        for edge in (picture[0], picture[-1], picture[:, 0], picture[:, -1]):
            assert (edge == 255).all()

    return check


@pytest.fixture
def make_recording() -> Callable[..., ExplorationRecording]:
    """A run along given positions in a walled room, its map growing from left to right."""

    def make(
        positions: list[tuple[float, float]],
        coverage: list[float],
        *,
        shape: tuple[int, int] = (20, 30),
        origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
        num_frames: int = 4,
        **changes: object,
    ) -> ExplorationRecording:
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
                ExplorationFrame(
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
                    sample_terms=dict(SAMPLE_TERMS),
                )
            )
        records = ExplorationRecord(
            state=states[1:],
            control=np.zeros((steps, 2), np.float32),
            coverage=np.array(coverage, np.float32),
            entropy=np.linspace(90.0, 10.0, steps).astype(np.float32),
            unknown=np.linspace(0.9, 0.1, steps).astype(np.float32),
            unknown_map=np.linspace(0.95, 0.3, steps).astype(np.float32),
            clearance=np.full(steps, 0.3, np.float32),
            is_collision=np.zeros(steps, bool),
            is_untraversable=np.zeros(steps, bool),
            effective_sample_size=np.full(steps, 8.0, np.float32),
            is_finite=np.ones(steps, bool),
            is_faulty=np.zeros(steps, bool),
            parts={},
            members=None,
        )
        covered = np.flatnonzero(records.coverage >= np.float32(0.99))
        recording = ExplorationRecording(
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
            elevation=None,
            traversable=None,
            mover_radii=np.zeros(0),
            member_names=(),
        )
        return dataclasses.replace(recording, **changes)

    return make


@pytest.fixture
def recording(make_recording: Callable[..., ExplorationRecording]) -> ExplorationRecording:
    """Ten steps of 0.2 m to the right, all of the room covered in the end."""
    positions = [(0.5 + 0.2 * k, 1.0) for k in range(11)]
    return make_recording(positions, [0.1, 0.2, 0.3, 0.5, 0.6, 0.7, 0.9, 0.95, 0.97, 0.99])


@pytest.fixture
def no_step(make_recording: Callable[..., ExplorationRecording]) -> ExplorationRecording:
    """A run that ended before its first step."""
    return make_recording([(0.5, 1.0)], [])


CORNERS = np.array([[0.4, 0.15], [-0.2, 0.15], [-0.2, -0.15], [0.4, -0.15]])
"""Of a robot that is 0.6 m long and 0.3 m wide, in its own frame [m]."""
MEMBERS = ("bold", "careful", "slow")


def ground_vehicle(recording: ExplorationRecording) -> ExplorationRecording:
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
    worst = np.where(k < steps // 2, 20.0, 10.0 - np.abs(k - 6.0)).astype(np.float32)
    wheels = WheelRecord(
        load_transfer=(1.1 * k / max(1, steps - 1)).astype(np.float32),
        wheel_travel=np.where(k % 4 == 3, 1.5, 0.5).astype(np.float32),
        is_tipped=k >= steps - 1,
    )
    records = recording.records._replace(
        is_untraversable=k >= steps - 2,
        parts={"watch": WatchRecord(k, worst), "wheels": wheels},
        members=members,
    )
    traversable = (column < 0.6 * columns) | (row < 0.6 * rows)
    idleness = np.where(column < columns / 2, 0.1 * column, np.inf).astype(np.float32)
    run = dataclasses.replace(
        recording,
        records=records,
        frames=tuple(frames),
        target_coverage=None,
        finished_step=None,
        footprint=CORNERS,
        elevation=(0.05 * column + 0.02 * row).astype(np.float32),
        traversable=traversable,
        parts={"watch": WatchReport(idleness, is_patrol=False), "wheels": WheelReport()},
        mover_radii=np.array([0.2, 0.3], np.float32),
        member_names=MEMBERS,
    )
    # In the order of the targets: one more after every third step.
    seen = np.minimum(np.arange(steps) // 3, 3)
    return as_search(run, targets, seen, lambda step: np.arange(3) < max(step - 1, 0) // 3)


def as_search(
    run: ExplorationRecording,
    places: np.ndarray,
    seen: np.ndarray,
    is_found: Callable[[int], np.ndarray],
    how: str = "seen",
) -> ExplorationRecording:
    """Return a run that looks for targets: how many were seen, and which ones before each step."""
    own = {"targets": TargetRecord(np.asarray(seen, np.int32))}
    frames = tuple(
        dataclasses.replace(
            each, parts={**each.parts, "targets": {"is_found": is_found(each.step)}}
        )
        for each in run.frames
    )
    records = run.records._replace(parts={**own, **run.records.parts})
    parts = {"targets": TargetReport(places, how), **run.parts}
    return dataclasses.replace(run, records=records, frames=frames, parts=parts)


@pytest.fixture
def make_search() -> Callable[..., ExplorationRecording]:
    """Return the maker of runs that look for targets."""
    return as_search


@pytest.fixture
def make_vehicle() -> Callable[[ExplorationRecording], ExplorationRecording]:
    """Add ground, targets, movers, a watch, members and a rectangle to a run."""
    return ground_vehicle


@pytest.fixture
def vehicle(recording: ExplorationRecording) -> ExplorationRecording:
    """A run of ten steps with ground, targets, movers, a watch, members and a rectangle."""
    return ground_vehicle(recording)


PATH_NAMES = ("x", "y", "yaw", "v", "phi")
RADIUS = 5.0
"""Of the ring [m]."""


def path_run(
    poses: Sequence[tuple[float, float, float]],
    progress: Sequence[float],
    *,
    num_frames: int = 4,
    **changes: object,
) -> PathRecording:
    """A run on a straight path of 10 m along x, through given poses, without anything beside it.

    Each frame has six rollouts that fan out ahead; `progress` has one entry more than steps.
    """
    steps = len(poses) - 1
    states = np.zeros((steps + 1, 5), np.float32)
    states[:, :3] = np.asarray(poses, np.float32).reshape(-1, 3)
    moves = np.hypot(*np.diff(states[:, :2], axis=0).T)
    states[1:, 3], states[:, 4] = moves / PERIOD, progress
    k = np.arange(steps, dtype=np.float32)
    records = PathRecord(
        state=states[1:],
        control=np.zeros((steps, 3), np.float32),
        contouring=(0.2 * (-1.0) ** k).astype(np.float32),
        lag=np.full(steps, 0.1, np.float32),
        progress=np.asarray(progress[1:], np.float32),
        deviation=np.zeros(steps, np.float32),
        room=np.full(steps, np.inf, np.float32),
        gap=np.full(steps, np.inf, np.float32),
        acceleration=np.stack([np.cos(k), np.sin(k)], axis=-1),
        effective_sample_size=np.full(steps, 8.0, np.float32),
        is_finite=np.ones(steps, bool),
        is_faulty=np.zeros(steps, bool),
    )
    recording = PathRecording(
        records=records,
        frames=tuple(
            _path_frame(int(step), states[step])
            for step in np.unique(np.linspace(0, steps, num_frames).round().astype(int))
        ),
        timing=Timing(2.0, 1.0, 100, np.array([0.01, 0.02, 0.03])),
        control_period=PERIOD,
        start=states[0],
        start_progress=float(progress[0]),
        centre=np.stack([np.linspace(0.0, 10.0, 21), np.zeros(21)], axis=-1).astype(np.float32),
        edges=np.zeros((0, 21, 2), np.float32),
        length=10.0,
        end=10.0,
        is_closed=False,
        state_names=PATH_NAMES,
        control_half_range=np.ones(3, np.float32),
        robot_radius=0.3,
        footprint=np.zeros((0, 2)),
        obstacle_radii=np.zeros(0),
        is_interrupted=False,
    )
    return dataclasses.replace(recording, **changes)


def _path_frame(step: int, state: np.ndarray) -> PathFrame:
    angles = state[2] + np.linspace(-0.5, 0.5, 6)
    ahead = np.linspace(0.0, 1.0, 5)[None, :, None]
    fan = ahead * np.stack([np.cos(angles), np.sin(angles)], axis=-1)[:, None]
    return PathFrame(
        step=step,
        time=step * PERIOD,
        position=state[:2],
        heading=float(state[2]),
        corners=np.zeros((0, 1, 2), np.float32),
        samples=(state[:2] + fan).astype(np.float32),
        weights=np.array([0.5, 0.1, 1e-3, 1e-9, 0.0, 0.3], np.float32),
        plan=(state[:2] + fan[2]).astype(np.float32),
        sample_terms=dict(SAMPLE_TERMS),
    )


@pytest.fixture
def make_straight() -> Callable[..., PathRecording]:
    """Make a run on an open path, without anything beside it."""
    return straight_run


def straight_run(**changes: object) -> PathRecording:
    """Ten steps of 1 m along an open path; a disc, nothing beside it."""
    along = np.arange(11.0)
    return path_run([(x, 0.0, 0.0) for x in along], list(along), **changes)


def ring_run(
    *, laps: int = 2, steps: int = 20, num_frames: int = 4, **changes: object
) -> PathRecording:
    """Laps of so many steps on a circle of 5 m, to the left, in a corridor 2 m wide.

    A car, a disc that goes round before it, and a rounded square and a bar that stand; the car is
    out of the corridor in steps 4, 5 and 7 and in contact in steps 12 and 13.
    """
    total = laps * steps
    angles = np.linspace(0.0, 2.0 * np.pi * laps, total + 1)
    poses = [(RADIUS * np.cos(a), RADIUS * np.sin(a), a + 0.5 * np.pi) for a in angles]
    recording = path_run(poses, list(RADIUS * angles), num_frames=num_frames)
    around = np.linspace(0.0, 2.0 * np.pi, 73)
    unit = np.stack([np.cos(around), np.sin(around)], axis=-1)
    room, gap = np.full(total, 0.5, np.float32), np.full(total, 1.5, np.float32)
    room[[4, 5, 7]] = [-0.1, -0.2, -0.1]
    gap[[12, 13]] = [-0.05, -0.02]
    frames = []
    for frame in recording.frames:
        disc = np.repeat([[RADIUS * np.cos(0.1 * frame.time), 4.8]], 4, axis=0)
        square = np.array([[-5.2, -0.2], [-4.8, -0.2], [-4.8, 0.2], [-5.2, 0.2]])
        bar = np.array([[-0.5, -5.0], [0.5, -5.0], [0.5, -5.0], [0.5, -5.0]])
        frames.append(dataclasses.replace(frame, corners=np.stack([disc, square, bar])))
    # The loop compares in the records' own precision.
    end = float(recording.records.progress[-1])
    ring = dataclasses.replace(
        recording,
        records=recording.records._replace(room=room, gap=gap),
        frames=tuple(frames),
        centre=(RADIUS * unit).astype(np.float32),
        edges=np.stack([(RADIUS - 1.0) * unit, (RADIUS + 1.0) * unit]).astype(np.float32),
        length=end / laps,
        end=end,
        is_closed=True,
        footprint=CORNERS,
        obstacle_radii=np.array([0.3, 0.1, 0.15]),
    )
    return dataclasses.replace(ring, **changes)


@pytest.fixture
def make_ring() -> Callable[..., PathRecording]:
    """Make laps in a corridor, with obstacles."""
    return ring_run


@pytest.fixture
def straight() -> PathRecording:
    """Ten steps of 1 m along an open path."""
    return straight_run()


@pytest.fixture
def ring() -> PathRecording:
    """Two laps of twenty steps in a corridor, with obstacles."""
    return ring_run()


@pytest.fixture
def path_start() -> PathRecording:
    """A run along a path that ended before its first step."""
    return path_run([(0.0, 0.0, 0.0)], [0.0])


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, tuple[float, float]]]:
    """All that is written into pictures, with its place."""
    texts = []
    text = ImageDraw.ImageDraw.text

    def note(self, position, words, *others, **more):
        texts.append((words, position))
        return text(self, position, words, *others, **more)

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", note)
    return texts


@pytest.fixture
def fleet_run(recording: ExplorationRecording) -> ExplorationRecording:
    """Return a run of two robots with numbers at random; the second hears the first at the end."""
    shape, steps = (4, 6), 6
    random = np.random.default_rng(1)
    states = random.uniform(-2.0, 2.0, (steps, 6)).astype(np.float32)
    start = np.array([0.0, 0.5, 0.1, 1.0, 1.5, 0.2], np.float32)
    shares, ones = random.random((steps, 2)).astype(np.float32), np.ones(steps, np.float32)
    hits = np.zeros((steps, 2), bool)
    hits[1, 0] = True
    records = ExplorationRecord(
        state=states,
        control=np.ones((steps, 4), np.float32),
        coverage=ones,
        entropy=None,
        unknown=None,
        unknown_map=None,
        clearance=shares + 1.0,
        is_collision=hits,
        is_untraversable=np.zeros((steps, 2), bool),
        effective_sample_size=ones,
        is_finite=np.ones(steps, bool),
        is_faulty=np.zeros(steps, bool),
        parts={
            "team": TeamRecord(shares, np.zeros((steps, 2), bool), ones, np.ones(steps, np.int32))
        },
        members=None,
    )
    frames = tuple(
        ExplorationFrame(
            step=step,
            time=step * 0.1,
            state=start if step == 0 else states[step - 1],
            heading=(start if step == 0 else states[step - 1])[[2, 5]],
            probability=random.integers(0, 256, shape, np.uint8),
            information=np.zeros((0, 0), np.float32),
            scan=np.zeros((0, 2)),
            samples=np.zeros((0, 1, 2)),
            weights=np.zeros(0),
            plan=random.random((2, 3, 2)).astype(np.float32),
            reference=np.zeros((0, 2)),
            movers=np.zeros((0, 2)),
            terms={},
            sample_terms={},
            parts={"team": {"links": np.array([[True, step > 0], [step > 0, True]])}},
        )
        for step in (0, 3, steps)
    )
    return ExplorationRecording(
        records=records,
        frames=frames,
        timing=recording.timing,
        control_period=0.1,
        is_interrupted=False,
        world=random.random(shape).astype(np.float32),
        belief=np.full(shape, 0.5, np.float32),
        parts={"team": TeamReport("claims", random.integers(0, 256, (2, *shape), np.uint8))},
        reachable=np.ones(shape, bool),
        origin=np.array([1.0, 2.0, 0.0]),
        resolution=0.5,
        start=start,
        state_names=("x_1", "y_1", "yaw_1", "x_2", "y_2", "yaw_2"),
        initial_unknown=0.9,
        initial_coverage=0.0,
        target_coverage=0.9,
        finished_step=None,
        given_up_step=None,
        robot_radius=np.array([0.2, 0.3], np.float32),
        footprint=(np.zeros((0, 2)), np.zeros((0, 2))),
        initial_entropy=12.0,
        goal=None,
        control_half_range=np.ones(4, np.float32),
        field_origin=np.array([1.0, 2.0, 0.0]),
        field_resolution=0.5,
        mover_radii=np.zeros(0),
        member_names=(),
    )


def as_patrol(run: ExplorationRecording) -> ExplorationRecording:
    """Return a run with a watch without its targets: it is judged by its idleness."""
    watch = dataclasses.replace(run.parts["watch"], is_patrol=True)
    parts = {name: each for name, each in run.parts.items() if name != "targets"}
    return dataclasses.replace(run, parts={**parts, "watch": watch})


@pytest.fixture
def make_patrol() -> Callable[[ExplorationRecording], ExplorationRecording]:
    """Leave out the targets of a run with a watch."""
    return as_patrol
