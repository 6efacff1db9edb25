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
from jaxplore.onboard.localisation import MapLocaliser
from jaxplore.onboard.log import DriveLog
from jaxplore.robot.localisation import Localisation
from jaxplore.sensing.beams import Scan
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.exploration.state import ExplorationState


class _Due(NamedTuple):
    """A scan that is to be mapped: its time, the pose of the lidar (3,), when it was taken, and
    what joins the odometry by then."""

    time: float
    scan: Scan
    pose: np.ndarray
    now: float
    joint: np.ndarray | None


class Known(NamedTuple):
    """What a robot knows at a time.

    Args:
        state: the state with the belief.
        correction: (3,) pose of the odometry in the map; None where they are the same.
        time: time of the newest scan in the map [s].
    """

    state: ExplorationState
    correction: np.ndarray | None
    time: float = -math.inf


class Mapper:
    """Keeps the belief of a drive up to date.

    With a localisation, scans are mapped where they say that the robot is. `add` may be called from
    another thread than the other methods.

    Args:
        scenario: sensor and rates.
        log: log of the drive, which notes when cells became known.
        localisation: how the robot finds its pose; it is given when absent.

    Attributes:
        known: belief and correction, which change together.
        is_misfit: whether the newest scan contradicted the map.
    """

    def __init__(
        self,
        scenario: ExplorationScenario,
        log: DriveLog,
        localisation: Localisation | None = None,
    ) -> None:
        self._period = scenario.period
        self._scan_period = float(scenario.steps_per_scan) * self._period
        self._field_period = float(scenario.steps_per_field) * self._period
        self._sensor = scenario.sensors[0]
        self._log = log
        state = steps.initial(scenario)
        self._localiser: MapLocaliser | None = None
        if localisation is not None:
            start = on_device(np.asarray(scenario.robot.pose(scenario.start)))
            self._localiser = MapLocaliser(
                localisation, scenario.perception, scenario.map_arrays.prior, start
            )
        self.known = Known(state, None if localisation is None else np.zeros(3))
        self._due: _Due | None = None
        self._taken_at = self._mapped_at = self._derived_at = self._fit_at = -math.inf
        self.is_misfit = False

    @property
    def state(self) -> ExplorationState:
        """The state with the belief."""
        return self.known.state

    @property
    def belief(self) -> Belief:
        """What the robot knows, relative to the first position."""
        return self.state.belief

    @property
    def correction(self) -> np.ndarray | None:
        """Pose (3,) of the odometry in the map; None where they are the same."""
        return self.known.correction

    def prepare(self, perception: Perception) -> None:
        """Compile what the other methods call."""
        number = self._sensor.num_beams
        scan = Scan(jnp.zeros(number), jnp.zeros(number, bool))
        pose, second = jnp.zeros(3), jnp.ones(())
        never = jnp.array(False)
        belief = steps.observe(perception, self.belief, scan, pose, second, never).belief
        jax.block_until_ready(steps.derive(perception, belief, pose, second))  # type: ignore[no-untyped-call]
        if self._localiser is not None:
            self._localiser.prepare(perception, belief)
            steps.free_cells(belief)

    def add(
        self,
        time: float,
        scan: Scan,
        pose: np.ndarray,
        now: float,
        joint: np.ndarray | None = None,
    ) -> None:
        """Take a scan; it is mapped by the next call of `map_scan` if its period is over.

        Args:
            time: time of the scan [s].
            scan: the scan.
            pose: (3,) pose of the lidar by the odometry, relative to the origin of the belief
                [m, m, rad].
            now: present time [s].
            joint: (3,) what joins the odometry after its jumps, see `MapPoses`; None without a
                localisation.
        """
        if time - self._taken_at >= self._scan_period - 0.5 * self._period:
            self._taken_at, self._due = time, _Due(time, scan, pose, now, joint)

    def map_scan(self, perception: Perception) -> None:
        """Map the newest scan that is due, if it fits the map.

        After `RETRY_SECONDS` of scans that do not fit, the world has changed, and they are mapped.
        """
        due, self._due = self._due, None
        if due is None:
            return
        is_first = not math.isfinite(self._mapped_at)
        elapsed = self._scan_period if is_first else due.time - self._mapped_at
        localiser, pose = self._localiser, due.pose
        if localiser is not None:
            pose = localiser.corrected(due.time, due.scan, due.pose, due.joint)
        is_changed = self.is_misfit and due.time - self._fit_at > RETRY_SECONDS
        mapped = steps.observe(
            perception,
            self.belief,
            due.scan,
            on_device(pose.astype(np.float32)),
            jnp.asarray(elapsed, jnp.float32),
            jnp.asarray(is_changed),
        )
        belief, is_misfit = mapped.belief, bool(mapped.is_misfit)
        self._log.add_known(due.now, np.asarray(mapped.is_free))
        if localiser is not None:
            if is_misfit and not is_changed:
                localiser.reject()
            belief = localiser.revised(perception, belief)
            if belief is not mapped.belief:
                self._log.add_known(due.now, np.asarray(steps.free_cells(belief)))
        correction = None if localiser is None else localiser.correction
        self.known = Known(self.state.with_belief(belief), correction, due.time)
        self.is_misfit = is_misfit
        if not is_misfit:
            self._fit_at = due.time
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
        self.known = self.known._replace(state=self.state.with_belief(belief))
        self._derived_at = now
        return float(cost)
