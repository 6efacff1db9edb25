"""The map of a drive and its fields, which no command waits for."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxplore._xla import on_device
from jaxplore.belief.belief import Belief
from jaxplore.belief.perception import Perception
from jaxplore.localisation.localiser import Localiser, LocaliserState, thin_scans
from jaxplore.onboard import steps
from jaxplore.onboard.localisation import (
    ScanMotions,
    close_any,
    compose,
    inverse,
    replace_known,
    scan_room,
)
from jaxplore.onboard.log import DriveLog
from jaxplore.robot.localisation import Localisation, Motions
from jaxplore.robot.robot import FITTING, RobotState
from jaxplore.sensing.beams import Scan
from jaxplore.simulation.exploration.scenario import ExplorationScenario


class _Due(NamedTuple):
    """A scan that is to be mapped, as `Mapper.add` takes it."""

    time: float
    scan: Scan
    pose: np.ndarray
    now: float
    joint: np.ndarray | None


class Known(NamedTuple):
    """What a robot knows: its map, and its pose at the newest scan.

    `time` is that of this scan [s]. The correction (3,) is the pose of the odometry in the map;
    None where they are the same.
    """

    own: RobotState
    correction: np.ndarray | None
    time: float = -math.inf

    @property
    def belief(self) -> Belief:
        """What the robot knows of the world."""
        return self.own.belief


class Mapper:
    """Keeps what a robot knows on a drive up to date, see `Robot`.

    With a localisation, scans are mapped where they say that the robot is, and at its rate loops
    are closed; without one the pose is given. The log notes when cells became known. `add` and
    `distrust` may be called from another thread than the other methods.

    `known` has what the robot knows and the correction of its odometry, which change together.
    `is_misfit` is whether the newest scan contradicted the map. A localisation on a known map,
    which a robot has none of here, raises a `ValueError`.
    """

    def __init__(
        self,
        scenario: ExplorationScenario,
        log: DriveLog,
        localisation: Localisation | None = None,
    ) -> None:
        if localisation is not None and not isinstance(localisation.localiser, Localiser):
            raise ValueError(
                f"localisation has a {type(localisation.localiser).__name__}; accepted on a robot: "
                "a Localiser, which makes its map"
            )
        self._period = scenario.period
        self._scan_period = float(scenario.rates.since_scan)
        self._field_period = float(scenario.rates.since_fields)
        self._log = log
        self._prior = scenario.map_arrays.prior
        self._start = on_device(np.asarray(scenario.robot.pose(scenario.start)))
        self._robot = scenario.onboard._replace(
            localisation=localisation, prior=None if localisation is None else self._prior
        )
        self._no_misfit = on_device(np.array(FITTING, np.float32))
        own = steps.initial(scenario).own._replace(points=None, place=None, unfit=self._no_misfit)
        if localisation is not None:
            own = own._replace(
                place=localisation.init(self._start, own.belief.grid, self._robot.sensors, None)
            )
        self.known = Known(own, None if localisation is None else np.zeros(3))
        self._motions = ScanMotions()
        self._due: _Due | None = None
        self._instruments = {
            part.name: part for part in scenario.perception.parts if part.has_instrument
        }
        self._looks: dict[str, tuple[float, float]] = {}
        self._origin: np.ndarray | None = None
        self._has_places = bool(scenario.perception.parts)
        self._closed: np.ndarray | None = None
        self._is_distrusted = self.is_misfit = False
        self._taken_at = self._mapped_at = self._derived_at = self._closed_at = -math.inf

    @property
    def belief(self) -> Belief:
        """What the robot knows, relative to the first position."""
        return self.known.belief

    @property
    def correction(self) -> np.ndarray | None:
        """Pose (3,) of the odometry in the map; None where they are the same."""
        return self.known.correction

    def prepare(self, perception: Perception) -> None:
        """Compile what the other methods call; to close loops without GTSAM is a `ValueError`."""
        robot, own = self._robot._replace(perception=perception), self.known.own
        pose, second, scan = jnp.zeros(3), jnp.ones(()), scan_room(self._robot.sensors[0])
        localisation, motions = robot.localisation, None
        if self._has_places:
            steps.locate_parts(perception, own.belief, jnp.zeros(2))
        for part in self._instruments.values():
            steps.look(part, own.belief, second, second)
        if localisation is not None:
            motions = Motions(jnp.zeros((2, 3)), jnp.ones((), jnp.int32), second)
        inputs = steps.MapInputs(pose, scan, second, motions)
        own, _ = steps.map_scan(robot, own, inputs)
        jax.block_until_ready(steps.update_fields(robot, own, pose, second))  # type: ignore[no-untyped-call]
        if localisation is None or localisation.closer is None or own.place is None:
            return
        # A place is seen again where the odometry is a fifth of a metre off, after a way on which
        # surfaces were forgotten, and any match counts: the search, the pose graph and the new map
        # run once.
        assert isinstance(localisation.localiser, Localiser)
        off, way = jnp.array([[0.2, 0.0, 0.0]] * 2), localisation.localiser.memory + 1.0
        inputs = inputs._replace(motions=Motions(off, jnp.ones((), jnp.int32), second))
        own = own._replace(place=replace_known(own.place, way=way))
        own, _ = steps.map_scan(robot, own, inputs)
        assert own.place is not None
        eager = localisation.replace_closer(close_any(localisation.closer))
        place, belief = eager.close_loops(
            own.place, own.belief, perception, self._prior, self._start
        )
        assert isinstance(place.known, LocaliserState)
        made = (steps.free_cells(belief), thin_scans(place.known))
        jax.block_until_ready(made)  # type: ignore[no-untyped-call]

    def add(
        self,
        time: float,
        scan: Scan,
        pose: np.ndarray,
        now: float,
        joint: np.ndarray | None = None,
    ) -> None:
        """Take a scan; it is mapped by the next call of `map_scan` if its period is over.

        `time` is that of the scan, and `now` the present one [s]. `pose` (3,) is that of the lidar
        by the odometry, relative to the origin of the belief [m, m, rad]. `joint` (3,) is that of
        `MapPoses`; None without a localisation.
        """
        if time - self._taken_at >= self._scan_period - 0.5 * self._period:
            self._taken_at, self._due = time, _Due(time, scan, pose, now, joint)

    def locate(self, origin: np.ndarray) -> None:
        """Take the position (2,) of the origin of the belief in the frame of the poses [m], before
        the first scan; the places of parts are in that frame."""
        self._origin = origin

    @property
    def is_located(self) -> bool:
        """Whether the parts have their places in the map."""
        return not self._has_places

    def is_closed(self, place: np.ndarray) -> bool:
        """Check whether the robot must not enter the cell of a position (2,) in the map."""
        cells = self._closed
        if cells is None:
            return False
        # The map of a drive is not turned. No JAX here: this runs between commands.
        frame = self.known.belief.grid.frame
        corner = np.asarray(frame.origin, np.float64)[:2]
        column, row = np.floor((place - corner) / frame.resolution).astype(int).tolist()
        is_in = 0 <= row < cells.shape[0] and 0 <= column < cells.shape[1]
        return bool(is_in and cells[row, column])

    def look(self, name: str, measured: float, time: float) -> None:
        """Take a measurement by the instrument of a part at a time [s]; the newest counts.

        A part that the robot does not have, or without an instrument, is a `ValueError`.
        """
        if name not in self._instruments:
            accepted = ", ".join(self._instruments) or "none, for no part has an instrument"
            raise ValueError(f"name is {name!r}; accepted: {accepted}")
        # Another thread takes them, so the dictionary is replaced and never changed.
        self._looks = {**self._looks, name: (measured, time)}

    def distrust(self) -> None:
        """Note that for a while no scan was taken, because the pose may not be true: scans that did
        not fit before tell nothing of the world."""
        self._is_distrusted = True

    def map_scan(self, perception: Perception) -> None:
        """Let the robot map the newest scan that is due, see `Robot.map_scans`."""
        self._take_places(perception)
        self._take_looks()
        due, self._due = self._due, None
        if due is None:
            return
        own, robot = self.known.own, self._robot._replace(perception=perception)
        if self._is_distrusted:
            self._is_distrusted, own = False, own._replace(unfit=self._no_misfit)
        motions = None
        if own.place is not None:
            if not (np.isfinite(due.pose).all() and np.isfinite(np.asarray(due.scan.ranges)).all()):
                # Nothing is measured, and the motion is a part of the next one.
                return
            if self._motions.is_first:
                # The first scan says where the map begins.
                own = own._replace(place=replace_known(own.place, pose=due.pose))
            motions = self._motions.add(due.time, due.pose, due.joint)
        is_first = not math.isfinite(self._mapped_at)
        elapsed = self._scan_period if is_first else due.time - self._mapped_at
        given = (due.pose.astype(np.float32), due.scan, np.float32(elapsed))
        pose, scan, since = jax.device_put(given)
        own, is_free = steps.map_scan(robot, own, steps.MapInputs(pose, scan, since, motions))
        self._log.add_known(due.now, np.asarray(is_free))
        self.is_misfit = bool(np.asarray(own.unfit) >= 0.0)
        correction = None
        if robot.localisation is not None:
            own = self._close_loops(robot.localisation, perception, own, due)
            assert own.place is not None
            # What turns the pose by the odometry into the one that was found.
            pose = np.asarray(own.place.known.pose, np.float64)
            correction = compose(pose, inverse(due.pose))
        self.known = Known(own, correction, due.time)
        self._mapped_at = due.time

    def _take_places(self, perception: Perception) -> None:
        """Place the parts in the map, once its origin is known."""
        if self._origin is None or not self._has_places:
            return
        own, origin = self.known.own, on_device(self._origin.astype(np.float32))
        belief, closed = steps.locate_parts(perception, own.belief, origin)
        self.known = self.known._replace(own=own._replace(belief=belief))
        self._closed = None if closed is None else np.asarray(closed)
        self._has_places = False

    def _take_looks(self) -> None:
        """Let parts know what their instruments have measured since the last scan."""
        looks, self._looks = self._looks, {}
        for name, given in looks.items():
            own = self.known.own
            measured, time = jax.device_put(tuple(np.float32(each) for each in given))
            belief = steps.look(self._instruments[name], own.belief, measured, time)
            self.known = self.known._replace(own=own._replace(belief=belief))

    def update_fields(self, perception: Perception, now: float, pose: np.ndarray) -> float | None:
        """Update the information and guidance fields if they are due.

        `pose` (3,) is that of the robot, relative to the origin of the belief [m, m, rad]. Return
        the cost-to-go of the guidance field there [m]; None if no update was due.
        """
        if now - self._derived_at < self._field_period - 1e-3:
            return None
        is_first = not math.isfinite(self._derived_at)
        elapsed = self._field_period if is_first else now - self._derived_at
        given = jax.device_put((pose.astype(np.float32), np.float32(elapsed)))
        robot = self._robot._replace(perception=perception)
        own, cost = steps.update_fields(robot, self.known.own, *given)
        self.known = self.known._replace(own=own)
        self._derived_at = now
        return float(cost)

    def _close_loops(
        self, localisation: Localisation, perception: Perception, own: RobotState, due: _Due
    ) -> RobotState:
        """Close loops if it is time; note the cells that are free where that moved the map."""
        closing_period = 1.0 / localisation.closing_rate
        if localisation.closer is None or due.time - self._closed_at < closing_period - 1e-3:
            return own
        self._closed_at = due.time
        assert own.place is not None
        place, belief = localisation.close_loops(
            own.place, own.belief, perception, self._prior, self._start
        )
        if belief is not own.belief:
            self._log.add_known(due.now, np.asarray(steps.free_cells(belief)))
        return own._replace(place=place, belief=belief)
