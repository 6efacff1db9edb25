import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import DifferentialDrive, Dynamics, State
from jaxplore.belief.belief import Belief
from jaxplore.belief.guidance import GuidanceField
from jaxplore.information.field import InformationField
from jaxplore.maps.field import ScalarField
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid


@pytest.fixture(scope="session")
def belief() -> Belief:
    """Return linear fields: bilinear interpolation is exact, so every cost has a closed form."""
    frame = GridFrame(1.0)
    rows, columns = np.mgrid[:9, :9].astype(np.float32)
    return Belief(
        grid=OccupancyGrid(np.zeros((9, 9)), 1.0),
        clearance=ScalarField(jnp.asarray(0.1 * (columns + 0.5)), frame, jnp.zeros(())),
        information=InformationField(
            sectors=jnp.asarray(np.stack([rows, 2 * rows])),
            cumulative=jnp.asarray(np.stack([0 * rows, rows, 3 * rows])),
            source=jnp.zeros((9, 9)),
            frame=frame,
            field_of_view=2 * math.pi,
            num_beams=10,
        ),
        guidance=GuidanceField(
            jnp.asarray(2.0 * columns - rows),
            jnp.stack([jnp.full((9, 9), 0.6), jnp.full((9, 9), 0.8)]),
            frame,
            jnp.asarray(1e4),
        ),
        dwell=jnp.zeros((9, 9)),
    )


@pytest.fixture(scope="session")
def at():
    """Return what makes the state of a differential drive."""
    robot = DifferentialDrive(radius=0.2, max_acceleration=2.0, max_angular_acceleration=4.0)

    def make(x: float, y: float, yaw: float = 0.0, v: float = 0.0) -> State:
        return State(jnp.asarray([x, y, yaw, v, 0.0], jnp.float32), robot)

    return make


@pytest.fixture(scope="session")
def stage(belief: Belief):
    """Return what evaluates a stage cost on the belief."""

    def evaluate(cost, state: State, control: tuple[float, float] = (0.0, 0.0)) -> float:
        return float(cost.stage(state, jnp.asarray(control), jnp.asarray(0.1), belief))

    return evaluate


class Drone(Dynamics):
    """Has every component that a cost may name; its bounds lie on one side, or on none."""

    state_names: ClassVar[tuple[str, ...]] = ("x", "y", "z", "yaw", "v")
    control_names: ClassVar[tuple[str, ...]] = ("thrust", "brake", "locked")
    control_min: jax.Array = eqx.field(default_factory=lambda: jnp.asarray([1.0, -4.0, 0.0]))
    control_max: jax.Array = eqx.field(default_factory=lambda: jnp.asarray([3.0, 0.0, 0.0]))
    radius: jax.Array = eqx.field(default_factory=lambda: jnp.asarray(0.3))

    def step(self, state, control, dt):
        return state


class Shuffled(Drone):
    """The same in another order, and more of it."""

    state_names: ClassVar[tuple[str, ...]] = ("omega", "v", "yaw", "z", "bias", "y", "x")


class Sled(Dynamics):
    """Names and order of its own: costs must not care."""

    state_names: ClassVar[tuple[str, ...]] = ("heave", "north", "east", "surge")
    control_names: ClassVar[tuple[str, ...]] = ("push",)
    control_min: jax.Array = eqx.field(default_factory=lambda: -jnp.ones(1))
    control_max: jax.Array = eqx.field(default_factory=lambda: jnp.ones(1))
    radius: jax.Array = eqx.field(default_factory=lambda: jnp.asarray(0.2))

    def step(self, state, control, dt):
        return state

    def position(self, state):
        return jnp.stack([state[2], state[1]])

    def heading(self, state):
        return jnp.zeros(())

    def speed(self, state):
        return state[3]


@pytest.fixture(scope="session")
def sled():
    """Return what makes the state of a sled."""

    def make(x: float, y: float, v: float = 0.0) -> State:
        return State(jnp.asarray([9.0, y, x, v], jnp.float32), Sled())

    return make


def _maker(robot: Dynamics):
    def make(x=0.0, y=0.0, z=0.0, yaw=0.0, v=0.0) -> State:
        known = {"x": x, "y": y, "z": z, "yaw": yaw, "v": v}
        values = [known.get(name, 17.0) for name in robot.state_names]
        return State(jnp.asarray(values, jnp.float32), robot)

    return make


@pytest.fixture(scope="session")
def drone():
    """Return what makes the state of a drone from named components."""
    return _maker(Drone())


@pytest.fixture(scope="session")
def shuffled():
    """Return what makes the same state of a model with another order."""
    return _maker(Shuffled())


@pytest.fixture(scope="session")
def price():
    """Return what evaluates a stage cost that reads no belief; compiled once per kind of cost."""

    @eqx.filter_jit
    def evaluate(cost, state: State, t: jax.Array):
        return cost.stage(state, jnp.zeros(state.dynamics.control_size), t, None)

    return lambda cost, state, t=0.1: float(evaluate(cost, state, jnp.asarray(t, jnp.float32)))


@pytest.fixture(scope="session")
def slope():
    """Return what evaluates the gradient of a stage cost by the state (nx,)."""

    @eqx.filter_jit
    def evaluate(cost, state: State):
        def along(values):
            at = State(values, state.dynamics)
            control = jnp.zeros(state.dynamics.control_size)
            return cost.stage(at, control, jnp.zeros(()), None)

        return jax.grad(along)(state.values)

    return lambda cost, state: np.asarray(evaluate(cost, state))


@pytest.fixture(scope="session")
def moved():
    """Return the rigid motion of the plane, in double precision: (points, angle, shift) -> points.

    Directions and velocities turn only: their shift is zero.
    """

    def move(points, angle: float, shift=(0.0, 0.0)) -> np.ndarray:
        cos, sin = math.cos(angle), math.sin(angle)
        turned = np.asarray(points, np.float64) @ np.array([[cos, sin], [-sin, cos]])
        return turned + np.asarray(shift)

    return move
