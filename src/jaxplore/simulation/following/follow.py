"""Runs a robot along a path, chunk by chunk."""

import dataclasses
import functools
import time
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore import _checks
from jaxplore._types import Count, Key
from jaxplore.control.base import Controller
from jaxplore.simulation.chunks import CHUNK_SECONDS, Watched, watch
from jaxplore.simulation.following.path_loop import (
    PathLoopState,
    PathRecord,
    initial_path_state,
    is_on_the_way,
    run_path_chunk,
)
from jaxplore.simulation.following.scenario import PathScenario
from jaxplore.simulation.recording import Timing
from jaxplore.simulation.simulate import NUM_TRAJECTORIES, outline_of


class PathProgress(NamedTuple):
    """How far a run is: simulated `time` and `time_limit` [s], `progress` and `end` along the path
    [m], and wall-clock `seconds` since the loop was compiled."""

    time: float
    time_limit: float
    progress: float
    end: float
    seconds: float


@dataclasses.dataclass(frozen=True)
class PathFrame:
    """One look at a run, for drawing.

    Args:
        step: how many steps were done.
        time: since the start [s].
        position: (2,) of the robot [m].
        heading: of the robot [rad].
        corners: (N, V, 2) of the obstacles' polygons [m].
        samples: (S, T + 1, 2) positions of some rollouts [m].
        weights: (S,) their weights.
        plan: (T + 1, 2) positions along the nominal [m].
    """

    step: int
    time: float
    position: np.ndarray
    heading: float
    corners: np.ndarray
    samples: np.ndarray
    weights: np.ndarray
    plan: np.ndarray


@dataclasses.dataclass(frozen=True)
class PathRecording:
    """A run along a path: every step, some looks at it, and what is needed to judge and draw it.

    Args:
        records: `PathRecord` with a leading axis of steps.
        frames: looks at the run, evenly spread, the last one at its end.
        timing: wall-clock times.
        control_period: [s].
        start: (nx,) state at the start.
        start_progress: arc length at the start [m].
        centre: (P, 2) points of the path [m].
        edges: (2, P, 2) the corridor's left and right edge [m]; (0, P, 2) without one.
        length: of the path, or of a lap [m].
        end: arc length at which the run is finished [m].
        is_closed: whether the path is a lap.
        state_names: of the robot's state.
        control_half_range: (nu,) half the range between the bounds of each control.
        robot_radius: of the discs that cover the robot [m].
        footprint: (4, 2) corners of a rectangular robot in its own frame [m]; (0, 2) of a disc.
        obstacle_radii: (N,) by which the obstacles' polygons are thicker [m].
        is_interrupted: the user stopped the run; what is here was done before.
    """

    records: PathRecord
    frames: tuple[PathFrame, ...]
    timing: Timing
    control_period: float
    start: np.ndarray
    start_progress: float
    centre: np.ndarray
    edges: np.ndarray
    length: float
    end: float
    is_closed: bool
    state_names: tuple[str, ...]
    control_half_range: np.ndarray
    robot_radius: float
    footprint: np.ndarray
    obstacle_radii: np.ndarray
    is_interrupted: bool

    @property
    def num_steps(self) -> int:
        """How many steps were done."""
        return len(self.records.progress)

    @property
    def time(self) -> np.ndarray:
        """(N + 1,) at the start and after each step [s]."""
        return np.arange(self.num_steps + 1) * self.control_period

    @property
    def progress(self) -> np.ndarray:
        """(N + 1,) arc length at the start and after each step [m]."""
        return np.concatenate([[self.start_progress], self.records.progress])

    @property
    def positions(self) -> np.ndarray:
        """(N + 1, 2) positions of the robot, the start included [m]."""
        states = np.concatenate([self.start[None], self.records.state])
        return states[:, [self.state_names.index("x"), self.state_names.index("y")]]


def record_path_run(
    controller: Controller,
    scenario: PathScenario,
    num_steps: int,
    *,
    key: Key,
    on_progress: Callable[[PathProgress], None] = lambda _: None,
    num_trajectories: int = NUM_TRAJECTORIES,
) -> PathRecording:
    """Simulate until the end of the path is reached or the steps are done.

    Ctrl-C ends the run after the current chunk; what was done is returned.

    Args:
        controller: decides; it is told the scenario's control rate.
        scenario: where and how.
        num_steps: at most, in control periods.
        key: the same key gives the same run.
        on_progress: called after each chunk.
        num_trajectories: rollouts in each look at the run; with 0 there is no plan either.

    Raises:
        ValueError: a number of steps < 1, or of rollouts < 0.
    """
    limit = _checks.positive_int("num_steps", num_steps)
    rollouts = _checks.whole_number("num_trajectories", num_trajectories, at_least=0)
    period = round(float(scenario.control_period), 7)  # 0.02, not the nearest float32
    controller = controller.at_period(scenario.control_period)
    began = time.perf_counter()
    state = initial_path_state(controller, scenario)
    chunk, end = max(1, round(CHUNK_SECONDS / period)), float(scenario.end)

    def run(current: PathLoopState, steps: Count) -> tuple[PathLoopState, PathRecord, Count]:
        return run_path_chunk(controller, scenario, current, key, steps, chunk)

    def look(current: PathLoopState, step: int) -> PathFrame:
        seen = _look(controller, scenario, current, key, rollouts)
        arrays = {name: np.asarray(value) for name, value in seen.items()}
        heading = float(arrays.pop("heading"))
        return PathFrame(step=step, time=step * period, heading=heading, **arrays)

    def report(current: PathLoopState, total: int, seconds: float) -> None:
        way = float(current.progress)
        on_progress(PathProgress(total * period, limit * period, way, end, seconds))

    done = watch(
        run,
        functools.partial(is_on_the_way, scenario),
        look,
        state,
        began=began,
        limit=limit,
        chunk=chunk,
        on_chunk=report,
    )
    return path_recording_of(scenario, state, done)


def path_recording_of(
    scenario: PathScenario,
    before: PathLoopState,
    done: Watched[PathLoopState, PathRecord, PathFrame],
) -> PathRecording:
    """Return a run as NumPy arrays, with what is needed to judge and draw it.

    Args:
        scenario: where and how.
        before: the state before the first step.
        done: the loop that was run.
    """
    path, model, truth = scenario.path, scenario.model, scenario.true_obstacles(jnp.zeros(()))
    centre, edges = _drawn(scenario)
    return PathRecording(
        records=done.records,
        frames=done.frames,
        timing=done.timing,
        control_period=round(float(scenario.control_period), 7),
        start=np.asarray(scenario.start),
        start_progress=float(before.progress),
        centre=centre,
        edges=edges,
        length=float(path.length),
        end=float(scenario.end),
        is_closed=path.is_closed,
        state_names=model.state_names,
        control_half_range=np.asarray(0.5 * (model.control_max - model.control_min)),
        robot_radius=float(model.radius),
        footprint=outline_of(model.footprint),
        obstacle_radii=np.zeros(0) if truth is None else np.asarray(truth.outlines.radii),
        is_interrupted=done.is_interrupted,
    )


@eqx.filter_jit
def _look(
    controller: Controller,
    scenario: PathScenario,
    state: PathLoopState,
    key: Key,
    num_trajectories: int,
) -> dict[str, Array]:
    track_key, plan_key = jax.random.split(jax.random.fold_in(key, state.step))
    time = scenario.control_period * state.step.astype(jnp.float32)
    model = scenario.model
    seen = {
        "position": model.position(state.robot),
        "heading": model.heading(state.robot),
        "corners": jnp.zeros((0, 1, 2)),
        "samples": jnp.zeros((0, 1, 2)),
        "weights": jnp.zeros(0),
        "plan": jnp.zeros((0, 2)),
    }
    truth = scenario.true_obstacles(time)
    if truth is not None:
        seen["corners"] = truth.outlines.corners
    if num_trajectories:
        known = scenario.obstacles(time, key=track_key)
        plan = controller.inspect(
            state.controller, state.robot, known, key=plan_key, num_trajectories=num_trajectories
        )
        position = jax.vmap(model.position)
        seen["samples"] = jax.vmap(position)(plan.samples)
        seen["weights"], seen["plan"] = plan.weights, position(plan.nominal.states)
    return seen


def _drawn(scenario: PathScenario) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of the path, and those of its edges where it has room."""
    path = scenario.path
    centre, tangents = np.asarray(path.points), np.asarray(path.tangents)
    if not path.has_room:
        return centre, np.zeros((0, *centre.shape))
    normals = np.stack([-tangents[:, 1], tangents[:, 0]], axis=-1)
    left, right = np.asarray(path.half_widths).T[..., None]
    return centre, np.stack([centre + left * normals, centre - right * normals])
