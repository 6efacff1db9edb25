"""The log of a drive, and its recording."""

import csv
import dataclasses
import io
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore.belief.belief import Belief
from jaxplore.maps.collision import footprint_clearance
from jaxplore.onboard.frames import EvenFrames
from jaxplore.report.compute import Timing
from jaxplore.report.exploration.data import ExplorationRecord
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.simulation.exploration.reachability import reachable_cells
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.robot_fields import robot_fields

BATCH = 1024
"""Number of states whose clearance is computed by one call of a compiled program."""


TIME, SAMPLES, FINITE, FAULTY, STATE = range(5)
"""Columns of the table of commands; the state begins at the last one, and the control follows."""


class Rows:
    """Rows of numbers in one array, which doubles when it is full.

    A list of objects would take ten times the memory, and a drive goes on for hours. Another thread
    may read while one appends.
    """

    def __init__(self, width: int) -> None:
        self._array = np.zeros((64, width))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, *values: float) -> None:
        """Append a row."""
        if self._count == len(self._array):
            self._array = np.concatenate([self._array, np.zeros_like(self._array)])
        self._array[self._count] = values
        self._count += 1

    @property
    def array(self) -> np.ndarray:
        """All rows (N, width)."""
        # The count first: the array that is read after it has at least as many rows.
        count = self._count
        return self._array[:count]


class DriveLog:
    """States, commands and the growth of the map in a drive.

    Nobody knows the true world, so the final map stands for it: coverage is the share of the
    reachable free cells of the final map that were known at a time. A cell has the entropy ln 2
    until it is known to be free, and the one of the final map from then on. Contacts are not
    measured.
    """

    def __init__(self, scenario: ExplorationScenario) -> None:
        self._scenario = scenario
        size = scenario.robot.state_size
        self._rows = Rows(STATE + size + scenario.robot.control_size)
        self._control = STATE + size
        self._known_at = np.full(scenario.map_arrays.world.shape, np.inf, np.float32)
        self._commands = Rows(5)
        self._texts: dict[tuple[str, str], int] = {}
        self.frames = EvenFrames()

    @property
    def num_steps(self) -> int:
        """Number of control periods since the first entry."""
        if len(self._rows) < 2:
            return 0
        times = self._rows.array[:, TIME]
        return round(float(times[-1] - times[0]) / self._scenario.period)

    @property
    def num_commands(self) -> int:
        """Number of commands that were added."""
        return len(self._rows)

    @property
    def num_known(self) -> int:
        """Number of cells that were ever known to be free."""
        return int(np.isfinite(self._known_at).sum())

    def add(
        self,
        time: float,
        state: np.ndarray,
        control: np.ndarray,
        effective_sample_size: float,
        *,
        is_finite: bool,
        is_faulty: bool,
    ) -> None:
        """Add a command, with the newest measured state (nx,), relative to the origin of the map.

        The effective sample size is that of the rollouts; 0 without a plan. `is_finite` is whether
        a rollout was finite. `is_faulty` is whether the robot brakes for a fault, or the check
        replaced the command.
        """
        numbers = time, effective_sample_size, is_finite, is_faulty
        self._rows.add(*numbers, *state.tolist(), *control.tolist())

    def add_command(self, time: float, twist: np.ndarray, mode: str, reason: str) -> None:
        """Add a velocity command (vx, vy, omega), with what the pilot does and why."""
        # Most commands have the same text, which is kept once.
        text = self._texts.setdefault((mode, reason), len(self._texts))
        self._commands.add(time, *twist.tolist(), text)

    def command_table(self) -> str:
        """Return all commands as CSV: time since the first [s], velocities, mode and reason."""
        lines = io.StringIO()
        table = csv.writer(lines)
        table.writerow(("time", "vx", "vy", "omega", "mode", "reason"))
        texts, commands = list(self._texts), self._commands.array
        for time, *twist, text in commands.tolist():
            since = time - commands[0, 0]
            table.writerow(
                (f"{since:.4f}", *(f"{each:.5g}" for each in twist), *texts[round(text)])
            )
        return lines.getvalue()

    def add_known(self, time: float, is_free: np.ndarray) -> None:
        """Note the cells (H, W) that are known to be free at a time [s]."""
        np.minimum(self._known_at, np.where(is_free, np.float32(self._since(time)), np.inf),
                   out=self._known_at)  # fmt: skip

    def recording(
        self, belief: Belief, *, is_done: bool, offset: np.ndarray | None = None
    ) -> ExplorationRecording:
        """Make the recording of the drive, with the belief at the end.

        All positions are relative to the origin of the belief. With an offset (2,), the position of
        that origin [m], they are moved by it.
        """
        local = self._recording(belief, is_done=is_done)
        if offset is None:
            return local
        names = self._scenario.robot.state_names
        frames = tuple(each.move(offset, names) for each in local.frames)
        return dataclasses.replace(local.move(offset), frames=frames)

    def _recording(self, belief: Belief, *, is_done: bool) -> ExplorationRecording:
        """Return the recording relative to the origin of the belief."""
        scenario, rows = self._scenario, self._resample()
        grid, period = belief.grid, scenario.period
        cropped = grid.crop
        start = self._states(rows)[0] if len(rows) else np.asarray(scenario.start)
        known_at, probability = cropped(self._known_at), cropped(grid.probability)
        reachable = self._reachable(belief, start)
        count = max(int(reachable.sum()), 1)
        final_entropy = cropped(grid.entropy)
        # Rows of the same time have the same map, and a scan is known for the command after it.
        times = period * np.arange(len(rows)) + 1e-3
        order = np.sort(known_at[reachable])
        coverage = np.searchsorted(order, times) / count
        lost = np.cumsum(np.append(0.0, (math.log(2.0) - final_entropy[reachable])[
            np.argsort(known_at[reachable], kind="stable")]))  # fmt: skip
        entropy = math.log(2.0) * count - lost[np.searchsorted(order, times)]
        states = self._states(rows)
        records = self._records(rows, coverage, entropy, self._clearance(belief, states))
        return ExplorationRecording(
            records=records,
            frames=self.frames.all,
            timing=Timing(0.0, 0.0, 0, np.zeros(0)),
            control_period=period,
            is_interrupted=not is_done,
            **robot_fields(scenario.robot, jnp.asarray(start)),
            finished_step=len(rows) if is_done and len(rows) else None,
            target_coverage=None,
            target="information",
            member_names=(),
            world=probability,
            belief=probability,
            reachable=reachable,
            origin=np.asarray(grid.frame.origin),
            resolution=grid.resolution,
            field_origin=np.asarray(belief.information.frame.origin),
            field_resolution=belief.information.frame.resolution,
            initial_coverage=0.0,
            initial_entropy=math.log(2.0) * count,
            initial_unknown=1.0,
            goal=None,
            elevation=None,
            traversable=self._find_traversable(belief),
            mover_radii=np.zeros(0),
        )

    def _find_traversable(self, belief: Belief) -> np.ndarray | None:
        """Return the cells (H, W) that the robot may enter; None if it may enter all."""
        closed = self._scenario.perception.find_forbidden(belief)
        return None if closed is None else belief.grid.crop(~closed)

    def newest(self, first: int) -> tuple[ExplorationRecord, np.ndarray]:
        """Return the records of the commands from `first` on, and their times [s], for live views.

        Nobody knows yet what can be reached, so their coverage is the share of all cells of the map
        that are known to be free; entropy and clearance are 0.
        """
        rows = self._rows.array[first:]
        share = np.full(len(rows), self.num_known / self._known_at.size)
        nothing = np.zeros(len(rows))
        times = rows[:, TIME] - self._rows.array[0, TIME] if len(rows) else np.zeros(0)
        return self._records(rows, share, nothing, nothing), times

    def _states(self, rows: np.ndarray) -> np.ndarray:
        return rows[:, STATE : self._control].astype(np.float32)

    def _records(
        self, rows: np.ndarray, coverage: np.ndarray, entropy: np.ndarray, clearance: np.ndarray
    ) -> ExplorationRecord:
        never = np.zeros(len(rows), bool)
        # Records of a recording are in NumPy, those of the loop on the device.
        columns: dict[str, Any] = {
            "state": self._states(rows),
            "control": rows[:, self._control :].astype(np.float32),
            "coverage": coverage.astype(np.float32),
            "entropy": entropy.astype(np.float32),
            "unknown": (1.0 - coverage).astype(np.float32),
            "unknown_map": (1.0 - coverage).astype(np.float32),
            "parts": {},
            "clearance": clearance.astype(np.float32),
            "is_collision": never,
            "is_untraversable": never,
            "effective_sample_size": rows[:, SAMPLES].astype(np.float32),
            "is_finite": rows[:, FINITE].astype(bool),
            "is_faulty": rows[:, FAULTY].astype(bool),
            "members": None,
        }
        return ExplorationRecord(**columns)

    def _since(self, time: float) -> float:
        return float(time - self._rows.array[0, TIME]) if len(self._rows) else 0.0

    def _resample(self) -> np.ndarray:
        """Return the newest row at each control period; commands come at other times as well."""
        rows = self._rows.array
        if not len(rows):
            return rows
        wanted = rows[0, TIME] + self._scenario.period * np.arange(self.num_steps)
        return np.asarray(rows[np.searchsorted(rows[:, TIME], wanted + 1e-6) - 1])

    def _reachable(self, belief: Belief, start: np.ndarray) -> np.ndarray:
        grid, robot = belief.grid, self._scenario.robot
        try:
            x, y = np.asarray(robot.position(jnp.asarray(start)))
            cells = reachable_cells(grid.unpad(), np.array([x, y, 0.0]), float(robot.radius))
        except ValueError:
            # The map may have a wall at the start by now, such as a person who stood there.
            cells = np.asarray(grid.crop(grid.is_free))
        return np.asarray(cells, bool)

    def _clearance(self, belief: Belief, states: np.ndarray) -> np.ndarray:
        """Return the distance of the robot's edge from the walls of the final map [m]."""
        found = np.zeros(len(states), np.float32)
        for first in range(0, len(states), BATCH):
            some = states[first : first + BATCH]
            padded = np.concatenate([some, np.repeat(some[-1:], BATCH - len(some), axis=0)])
            batch = _clearances(self._scenario, belief, jnp.asarray(padded))
            found[first : first + BATCH] = np.asarray(batch)[: len(some)]
        return found


@eqx.filter_jit
def _clearances(
    scenario: ExplorationScenario, belief: Belief, states: Float[Array, "N nx"]
) -> Float[Array, " N"]:
    grid, robot = belief.grid, scenario.robot

    def clearance(state: Array) -> Array:
        return footprint_clearance(
            grid.is_occupied,
            grid.frame,
            robot.position(state),
            robot.heading(state),
            robot.footprint,
            scenario.clearance_reach,
        )

    found: Array = jax.lax.map(clearance, states, batch_size=64)
    return found
