"""The check that a quadrotor can stop in a volume, against its flight in double precision."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from jaxplore import Quadrotor
from jaxplore.control.validation import StopCheck
from jaxplore.maps.volume_field import VolumeField

pytestmark = pytest.mark.long

ROBOT = Quadrotor()
GRAVITY, LAG, RADIUS, TICK, PERIOD = 9.81, 0.05, 0.3, 0.05, 0.05
CHECK = StopCheck(0.0, evades=True)
NUM = 40
SIDE = 0.1
"""Of a voxel [m]."""
rng = np.random.default_rng(7)


@eqx.filter_jit
def checked(states, controls, points, is_point, speeds, age, room):
    def one(state, control):
        is_wall = is_point & (speeds == 0.0)
        given = jnp.float32(PERIOD), points, is_point, speeds, age, is_wall, room
        return CHECK(ROBOT, state, control, *given)

    return jax.vmap(one)(states, controls)


def rate(state: np.ndarray, control: np.ndarray) -> np.ndarray:
    """The model of a quadrotor in NED: x' of (p, v, q, w)."""
    v, (w, x, y, z), omega = state[3:6], state[6:10], state[10:]
    axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z])
    turning = np.array(
        [
            [-x, -y, -z],
            [w, -z, y],
            [z, w, -x],
            [-y, x, w],
        ]
    )
    return np.concatenate(
        [
            v,
            np.array([0.0, 0.0, GRAVITY]) - control[0] * axis,
            0.5 * turning @ omega,
            (control[1:] - omega) / LAG,
        ]
    )


def fly(state: np.ndarray, control: np.ndarray, seconds: float) -> np.ndarray:
    """Ten steps of the midpoint rule."""
    for _ in range(10):
        half = state + 0.05 * seconds * rate(state, control)
        state = state + 0.1 * seconds * rate(half, control)
        state[6:10] /= np.linalg.norm(state[6:10])
    return state


def braking(state: np.ndarray) -> np.ndarray:
    """The control that brakes: thrust along the wanted acceleration, rates that turn to it."""
    v, (w, x, y, z) = state[3:6], state[6:10]
    speed = np.hypot(v[0], v[1]) + 1e-12
    level = -min(1 / 0.3, 0.8 * GRAVITY / speed) * v[:2]
    down = np.clip(-v[2] / 0.3, -0.4 * GRAVITY, 0.4 * GRAVITY)
    wanted = np.array([-level[0], -level[1], GRAVITY - down])
    body = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    axis = body[:, 2]
    rates = (body.T @ np.cross(axis, wanted / np.linalg.norm(wanted))) / (2.5 * LAG)
    return np.concatenate(
        [[np.clip(wanted @ axis, 0, 4 * GRAVITY)], np.clip(rates, -10, 10)[:2], [0]]
    )


def rest(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (x, y, z), z up, and times until the robot that brakes stands."""
    places, times = [], []
    for number in range(51):
        places.append(state[:3] * [1, 1, -1])
        times.append(number * TICK)
        if number and np.abs(places[-1] - places[-2]).max() <= 1e-4:
            break
        state = fly(state, braking(state), TICK)
    return np.array(places), np.array(times)


def solid_box() -> tuple[np.ndarray, VolumeField]:
    """Voxels of a hall with a block in it, and the distance to them as a map has it."""
    solid = np.zeros((40, 60, 60), bool)
    solid[[0, -1]] = solid[:, [0, -1]] = solid[:, :, [0, -1]] = True
    solid[:, 20:30, 45:50] = True
    away = np.minimum(ndimage.distance_transform_edt(~solid) * SIDE, 1.2).astype(np.float32)
    origin = jnp.array([-3.0, -3.0, -2.0]) + 0.5 * SIDE
    return solid, VolumeField(jnp.asarray(away), origin, SIDE, jnp.zeros(()))


def test_it_accepts_what_can_stop_or_makes_way_and_replaces_the_rest() -> None:
    states = np.zeros((NUM, 13))
    states[:, :2] = rng.uniform(-0.4, 0.4, (NUM, 2))
    states[:, 3:6] = rng.uniform(-1.0, 1.0, (NUM, 3)) * [1, 1, 0.4]
    states[:, 3:6] *= np.linspace(0.0, 2.2, NUM)[:, None]
    states[:, 6:9] = np.column_stack([np.ones(NUM), rng.uniform(-0.15, 0.15, (NUM, 2))])
    states[:, 6:10] /= np.linalg.norm(states[:, 6:10], axis=1)[:, None]
    controls = rng.uniform([5, -2, -2, -1], [16, 2, 2, 1], (NUM, 4))
    points = rng.uniform([-2.5, -2.5, -0.8], [2.5, 2.5, 0.8], (90, 3))
    points = points[np.linalg.norm(points[:, :2], axis=1) > 1.8][:40]
    points[:6, :2] *= 1.6
    speeds = np.where(np.arange(len(points)) < 6, 1.6, 0.0)
    is_point = np.arange(len(points)) % 8 != 7
    solid, field = solid_box()
    given = (states, controls, points, is_point, speeds, 0.1)
    found = checked(*(jnp.asarray(each, jnp.asarray(each).dtype) for each in given), field)
    own = np.argwhere(solid)[:, ::-1] * SIDE + np.array([-3.0, -3.0, -2.0]) + 0.5 * SIDE

    def gaps(places: np.ndarray, times: np.ndarray) -> tuple[float, float]:
        """Least distance of the robot's edge from all, and from what stands."""
        far = np.linalg.norm(points[is_point] - places[:, None], axis=2)
        grown = far - speeds[is_point] * times[:, None] - RADIUS
        still = far[:, speeds[is_point] == 0] - RADIUS
        voxels = np.linalg.norm(own - places[:, None], axis=2).min(axis=1)
        room = np.minimum(voxels, 1.2).min() - RADIUS
        return min(grown.min(), room), min(still.min(), room)

    def from_movers(place: np.ndarray) -> float:
        moves = is_point & (speeds > 0)
        return float(np.linalg.norm(points[moves] - place, axis=1).min())

    counts = {"safe": 0, "evades": 0, "replaced": 0, "turned": 0}
    for state, control, is_replaced, taken in zip(
        states, controls, found.is_replaced, found.control, strict=True
    ):
        half = fly(state, control, 0.5 * PERIOD)
        after = fly(half, control, 0.5 * PERIOD)
        places, times = rest(after)
        once, _ = rest(state)
        first = [
            gaps(each[None, :3] * [1, 1, -1], np.array([t]))
            for each, t in ((state, 0.1), (half, 0.125))
        ]
        least, walls = gaps(places, times + 0.1 + PERIOD)
        least, walls = min(least, first[1][0]), min(walls, first[1][1])
        enough, enough_walls = (min(0.0, each) for each in first[0])
        gain = from_movers(places[-1]) - from_movers(once[-1])
        # Distances are interpolated and braking is sampled: near a limit it may be either.
        is_safe, is_sure = least >= enough, abs(least - enough) > 0.06
        is_way = walls >= enough_walls and gain >= 0
        is_plain = abs(walls - enough_walls) > 0.06 and (walls < enough_walls or abs(gain) > 0.01)
        if is_safe and is_sure:
            counts["safe"] += 1
            assert not is_replaced
        elif is_sure and is_way and is_plain:
            counts["evades"] += 1
            assert not is_replaced
        elif is_sure and is_plain and is_replaced:
            counts["replaced"] += 1
            assert not np.allclose(taken, control)
        elif is_sure and is_plain:
            # It may brake with a turn after the command: then the command stays.
            counts["turned"] += 1
            np.testing.assert_allclose(taken, control, rtol=1e-6)
    assert counts["safe"] > 3, counts
    assert counts["evades"] > 1, counts
    assert counts["replaced"] > 3, counts
    assert counts["turned"] < 4, counts
