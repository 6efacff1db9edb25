"""The map of a drive and its fields, which no command waits for."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxplore._xla import on_device
from jaxplore.belief.belief import Belief
from jaxplore.belief.perception import Perception
from jaxplore.control.plausibility import RETRY_SECONDS
from jaxplore.onboard import steps
from jaxplore.onboard.log import DriveLog
from jaxplore.sensing.beams import Scan
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.exploration.state import ExplorationState


class _Due(NamedTuple):
    """A scan that is to be mapped: its time, the pose of the lidar (3,), and when it was taken."""

    time: float
    scan: Scan
    pose: np.ndarray
    now: float


class Mapper:
    """Keeps the belief of a drive up to date.

    `add` may be called from another thread than the other methods.

    Args:
        scenario: sensor and rates.
        log: log of the drive, which notes when cells became known.

    Attributes:
        is_misfit: whether the newest scan contradicted the map.
    """

    def __init__(self, scenario: ExplorationScenario, log: DriveLog) -> None:
        self._period = scenario.period
        self._scan_period = float(scenario.steps_per_scan) * self._period
        self._field_period = float(scenario.steps_per_field) * self._period
        self._sensor = scenario.sensors[0]
        self._log = log
        self.state: ExplorationState = steps.initial(scenario)
        self._due: _Due | None = None
        self._taken_at = self._mapped_at = self._derived_at = self._fit_at = -math.inf
        self.is_misfit = False

    @property
    def belief(self) -> Belief:
        """What the robot knows, relative to the first position."""
        return self.state.belief

    def prepare(self, perception: Perception) -> None:
        """Compile what the other methods call."""
        number = self._sensor.num_beams
        scan = Scan(jnp.zeros(number), jnp.zeros(number, bool))
        pose, second = jnp.zeros(3), jnp.ones(())
        never = jnp.array(False)
        belief = steps.observe(perception, self.belief, scan, pose, second, never).belief
        jax.block_until_ready(steps.derive(perception, belief, pose, second))  # type: ignore[no-untyped-call]

    def add(self, time: float, scan: Scan, pose: np.ndarray, now: float) -> None:
        """Take a scan; it is mapped by the next call of `map_scan` if its period is over.

        Args:
            time: time of the scan [s].
            scan: the scan.
            pose: (3,) pose of the lidar, relative to the origin of the belief [m, m, rad].
            now: present time [s].
        """
        if time - self._taken_at >= self._scan_period - 0.5 * self._period:
            self._taken_at, self._due = time, _Due(time, scan, pose, now)

    def map_scan(self, perception: Perception) -> None:
        """Map the newest scan that is due, if it fits the map.

        After `RETRY_SECONDS` of scans that do not fit, the world has changed, and they are mapped.
        """
        due, self._due = self._due, None
        if due is None:
            return
        is_first = not math.isfinite(self._mapped_at)
        elapsed = self._scan_period if is_first else due.time - self._mapped_at
        mapped = steps.observe(
            perception,
            self.belief,
            due.scan,
            on_device(due.pose.astype(np.float32)),
            jnp.asarray(elapsed, jnp.float32),
            jnp.asarray(self.is_misfit and due.time - self._fit_at > RETRY_SECONDS),
        )
        self.state = self.state._replace(belief=mapped.belief)
        self.is_misfit = bool(mapped.is_misfit)
        if not self.is_misfit:
            self._fit_at = due.time
        self._log.add_known(due.now, np.asarray(mapped.is_free))
        self._mapped_at = due.time

    def update_fields(self, perception: Perception, now: float, pose: np.ndarray) -> float | None:
        """Update the information and guidance fields if they are due.

        Args:
            perception: perception of the task.
            now: present time [s].
            pose: (3,) pose of the robot, relative to the origin of the belief [m, m, rad].

        Returns:
            The cost-to-go of the guidance field at the robot [m]; None if no update was due.
        """
        if now - self._derived_at < self._field_period - 1e-3:
            return None
        is_first = not math.isfinite(self._derived_at)
        elapsed = self._field_period if is_first else now - self._derived_at
        belief, cost = steps.derive(
            perception,
            self.belief,
            on_device(pose.astype(np.float32)),
            jnp.asarray(elapsed, jnp.float32),
        )
        self.state = self.state._replace(belief=belief)
        self._derived_at = now
        return float(cost)
