"""The map of a drive and its fields, which no command waits for."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxplore._types import ArrayLike
from jaxplore._xla import on_device
from jaxplore.belief.belief import Belief
from jaxplore.belief.perception import Perception
from jaxplore.localisation.localiser import Localiser, LocaliserState, thin_scans
from jaxplore.localisation.particle_localiser import ParticleLocaliser
from jaxplore.onboard import steps
from jaxplore.onboard.finding import Finder
from jaxplore.onboard.localisation import (
    ScanMotions,
    close_any,
    compose,
    inverse,
    replace_known,
    scan_room,
)
from jaxplore.onboard.log import DriveLog
from jaxplore.onboard.session import Session, with_arrays
from jaxplore.robot.localisation import Localisation, Motions, PoseKnowledge
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
    are closed; without one the pose is given. The log notes when cells became known. `add`,
    `distrust` and `tell` may be called from another thread than the other methods.

    On a map that the robot knows, which its session has kept, or of the scenario for a
    localisation on known maps, it first finds itself (`Finder`), with `localiser` for a session.
    Until then nothing is mapped, and `lost` says why the robot must not drive. Afterwards a
    `Localiser` goes on from there, and a pose that is given is moved by what was found.

    `known` has what the robot knows and the correction of its odometry, which change together.
    `is_misfit` is whether the newest scan contradicted the map.
    """

    def __init__(
        self,
        scenario: ExplorationScenario,
        log: DriveLog,
        localisation: Localisation | None = None,
        *,
        session: Session | None = None,
        localiser: ParticleLocaliser | None = None,
        is_apart: bool = False,
    ) -> None:
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
        self._finder: Finder | None = None
        is_known_map = localisation is not None and not localisation.localiser.is_mapping
        resumed = None if session is None else session.kept
        if session is not None and resumed is not None:
            session.check(own)
            own = with_arrays(own, resumed.arrays)
            grid = own.belief.grid.with_probability(on_device(resumed.arrays["map"]))
            own = own._replace(belief=steps.with_map(scenario.perception, own.belief, grid))
        if is_known_map:
            assert localisation is not None
            localiser = localisation.localiser  # type: ignore[assignment]
        if resumed is not None or is_known_map:
            localiser = ParticleLocaliser() if localiser is None else localiser
            self._finder = Finder(
                localiser, scenario.sensors[0], own.belief.grid, jax.random.key(0)
            )
        self._expected: list[np.ndarray] = []
        self._predicted: np.ndarray | None = None
        # A pose that is given is that in the map, but for a session that was resumed elsewhere.
        self._moved = np.zeros(3) if is_apart else None
        self.known = Known(own, self._moved if localisation is None else np.zeros(3))
        self._motions = ScanMotions()
        self._due: _Due | None = None
        self._instruments = {
            part.name: part for part in scenario.perception.parts if part.has_instrument
        }
        self._looks: dict[str, tuple[float, float]] = {}
        self._origin: np.ndarray | None = None
        self._has_places = bool(scenario.perception.parts)
        self._closed: np.ndarray | None = None
        self._is_distrusted = self.is_misfit = self._is_found = self._is_astray = False
        self._taken_at = self._mapped_at = self._derived_at = self._closed_at = -math.inf

    @property
    def belief(self) -> Belief:
        """What the robot knows, relative to the first position."""
        return self.known.belief

    @property
    def correction(self) -> np.ndarray | None:
        """Pose (3,) of the odometry in the map; None where they are the same."""
        return self.known.correction

    @property
    def finds_itself(self) -> bool:
        """Whether the robot begins on a map that it knows, at a place that it does not."""
        return self._finder is not None

    @property
    def lost(self) -> str:
        """Why the robot must not drive as long as it does not know where it is; empty else."""
        return "" if self._finder is None or self._is_found else self._finder.reason

    def expect(self, pose: np.ndarray, correction: np.ndarray) -> None:
        """Take the newest pose (3,) of the lidar in a session, and that of the odometry in the map
        for the case that the odometry has gone on meanwhile, see `Finder.take`."""
        self._expected, self._predicted = [pose], correction

    def tell(self, pose: np.ndarray) -> None:
        """Take a pose (3,) of the lidar, relative to the origin of the belief [m, m, rad], at which
        somebody says that the robot is; a robot that knows its map alone is no `ValueError`."""
        if self._finder is None:
            raise ValueError(
                "a pose is given to a robot that makes its map; accepted: with node.map, or while "
                "it finds itself on the map of a session"
            )
        self._finder.tell(pose)
        self._is_found = False

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
        if self._finder is not None:
            self._finder.prepare()
            if own.place is not None and isinstance(own.place.known, LocaliserState):
                self._start_at(own.place, np.zeros(3), np.eye(3))
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
        if self._finder is not None and not self._is_found:
            self._find(self._finder, perception, due)
            return
        own, robot = self.known.own, self._robot._replace(perception=perception)
        if self._is_distrusted:
            self._is_distrusted, own = False, own._replace(unfit=self._no_misfit)
        motions = None
        if own.place is not None:
            if not (np.isfinite(due.pose).all() and np.isfinite(np.asarray(due.scan.ranges)).all()):
                # Nothing is measured, and the motion is a part of the next one.
                return
            if self._motions.is_first and isinstance(own.place.known, LocaliserState):
                # The first scan says where the map begins.
                own = own._replace(place=replace_known(own.place, pose=due.pose))
            motions = self._motions.add(due.time, due.pose, due.joint)
        is_first = not math.isfinite(self._mapped_at)
        elapsed = self._scan_period if is_first else due.time - self._mapped_at
        given_pose = due.pose if self._moved is None else compose(self._moved, due.pose)
        given = (given_pose.astype(np.float32), due.scan, np.float32(elapsed))
        pose, scan, since = jax.device_put(given)
        own, is_free = steps.map_scan(robot, own, steps.MapInputs(pose, scan, since, motions))
        self._log.add_known(due.now, np.asarray(is_free))
        self.is_misfit = bool(np.asarray(own.unfit) >= 0.0)
        correction = self._moved
        if robot.localisation is not None:
            own = self._close_loops(robot.localisation, perception, own, due)
            assert own.place is not None
            # What turns the pose by the odometry into the one that was found.
            pose = np.asarray(own.place.known.pose, np.float64)
            correction = compose(pose, inverse(due.pose))
        self.known = Known(own, correction, due.time)
        self._mapped_at = due.time
        if self._is_lost(own):
            # A robot that was carried away looks for itself on its whole map.
            assert self._finder is not None
            self._finder.begin()
            self._expected, self._predicted = [], None
            self._is_found, self._is_astray = False, True

    @staticmethod
    def _is_lost(own: RobotState) -> bool:
        """Check whether a robot on a known map does not know where it is."""
        if own.place is None or isinstance(own.place.known, LocaliserState):
            return False
        return not bool(np.asarray(own.place.known.is_known))

    def _find(self, finder: Finder, perception: Perception, due: _Due) -> None:
        """Let the robot find itself by a scan; begin there once the pose is certain."""
        if not (np.isfinite(due.pose).all() and np.isfinite(np.asarray(due.scan.ranges)).all()):
            return
        motions = self._motions.add(due.time, due.pose, due.joint)
        went_on = [] if self._predicted is None else [compose(self._predicted, due.pose)]
        found = finder.take(due.time, motions, due.scan, [*self._expected, *went_on])
        if found is None:
            return
        pose, own = np.asarray(found.pose, np.float64), self.known.own
        correction = compose(pose, inverse(due.pose))
        if self._is_astray:
            # What was mapped since the robot was carried away may be at a wrong place.
            own = own._replace(belief=steps.with_map(perception, own.belief, self._prior))
        if own.place is None:
            self._moved = correction
        elif isinstance(own.place.known, LocaliserState):
            own = own._replace(place=self._start_at(own.place, pose, found.found.covariance))
        else:
            own = own._replace(place=PoseKnowledge(found, None))
        own = own._replace(unfit=self._no_misfit)
        self._log.add_known(due.now, np.asarray(steps.free_cells(own.belief)))
        self.known = Known(own, correction, due.time)
        self._mapped_at, self.is_misfit, self._is_astray = due.time, False, False
        self._is_found = True

    def _start_at(
        self, place: PoseKnowledge, pose: np.ndarray, covariance: ArrayLike
    ) -> PoseKnowledge:
        """Return what a robot knows of its pose that has found itself on its own map."""
        localisation, known = self._robot.localisation, place.known
        assert localisation is not None
        assert isinstance(localisation.localiser, Localiser)
        assert isinstance(known, LocaliserState)
        given = jax.device_put((pose.astype(np.float32), np.asarray(covariance, np.float32)))
        after = steps.start_at((localisation.localiser, self._robot.sensors[0]), known, *given)
        return place._replace(known=after)

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
