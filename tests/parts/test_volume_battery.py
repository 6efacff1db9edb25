"""A battery in a volume: a quadrotor that returns to its dock, is charged there, and goes on."""

import heapq
import math

import jax
import numpy as np
import pytest
from tests.kinds import CAMERA, QUADROTOR, SIDE, volume, volume_controller

import jaxplore as jx
from jaxplore.maps.datum import ORIGIN
from jaxplore.parts.battery.robot import JOULES, Battery
from jaxplore.parts.battery.truth import DOCK_RADIUS, TrueBattery, drive_length
from jaxplore.planning.strategy.volume_approach import GoalApproach
from jaxplore.simulation.exploration.part_truth import Site
from jaxplore.tasks.registry import build, make_settings

DOCK = (6.5, 1.0, 1.2)
"""Behind the half wall, where the robot does not see it from its start."""
NUMBERS = {"idle": 20.0, "per_metre": 5.0, "mass": 1.0, "cruise": 0.6}
BATTERY = Battery(DOCK, capacity=0.15, reserve=0.3, enough=0.9, **NUMBERS)


def scenario(battery: Battery = BATTERY, *, has_wall: bool = True, **more) -> jx.VolumeScenario:
    """Return an exploration without an end of its own."""
    perception = jx.VolumePerception([CAMERA], SIDE, QUADROTOR.radius, parts=[battery])
    truth = TrueBattery(battery, **{"power": 100.0, **more})
    return volume(
        has_wall,
        perception=perception,
        target_coverage=1.0,
        give_up_after=1e3,
        truths=[truth],
    )


@pytest.mark.long
def test_a_quadrotor_returns_is_charged_and_goes_on(tmp_path) -> None:
    """Twice; and a battery that is charged too slowly runs empty, by the same program."""
    controller = GoalApproach(volume_controller(), QUADROTOR)
    run = jx.simulate(controller, scenario(), 1000, key=jax.random.key(0), num_trajectories=0)
    recording, metrics = run.recording, run.metrics.parts["battery"]
    record = recording.records.parts["battery"]
    charge, is_docked = np.asarray(record.charge), np.asarray(record.is_docked)
    assert metrics.recharges >= 2
    assert metrics.empty_at is None
    # It is at the dock before the reserve is touched by more than it takes to come to rest.
    assert charge.min() > 0.25
    away = np.linalg.norm(recording.positions[1:] - np.asarray(DOCK), axis=1)
    assert (away[is_docked] <= DOCK_RADIUS + 1e-3).all()
    # It leaves when it is full as far as is wanted, and sees the other half before and after.
    leaves = np.flatnonzero(np.diff(is_docked.astype(int)) < 0)
    assert (charge[leaves] >= 0.88).all()
    first = int(np.flatnonzero(is_docked & (charge < 0.7))[0])
    far = recording.positions[:, 0] < 3.0
    assert far[:first].any()
    assert far[first:].any()
    assert not np.asarray(recording.records.is_collision).any()
    # The energy of the record is that of time, way and speeds, in float64.
    states = np.concatenate([recording.start[None], recording.records.state]).astype(np.float64)
    moved = np.linalg.norm(np.diff(states[:, :3], axis=0), axis=1)
    gained = np.maximum(np.diff((states[:, 3:6] ** 2).sum(axis=1)), 0.0)
    used = 20.0 * 0.05 + 5.0 * moved + 0.5 * gained
    before, most = np.concatenate([[1.0], charge[:-1]]), 0.15 * JOULES
    expected = before * most - used + np.where(is_docked, 100.0 * 0.05, 0.0)
    np.testing.assert_allclose(charge * most, np.clip(expected, 0.0, most), atol=0.01)
    # It is reported, drawn, kept and read again.
    assert dict(run.metrics.rows())["recharges"].startswith(f"{metrics.recharges}, ")
    run.save(tmp_path / "run")
    assert (tmp_path / "run" / "battery.png").stat().st_size > 0
    again = jx.Run.load(tmp_path / "run")
    assert again.metrics == run.metrics
    ((place, _),) = again.recording.marks(again.recording.frames[-1])
    np.testing.assert_array_equal(place, np.float32(DOCK))
    with np.load(tmp_path / "run" / "arrays.npz", allow_pickle=False) as arrays:
        np.testing.assert_array_equal(arrays["charge"], charge)

    slow = scenario(power=1e-3, charge=0.9)
    run = jx.simulate(controller, slow, 1000, key=jax.random.key(0), num_trajectories=0)
    metrics = run.metrics.parts["battery"]
    assert metrics.empty_at == pytest.approx(run.metrics.duration)
    assert run.metrics.num_steps < 1000
    assert "battery empty" in dict(run.metrics.rows())


def test_the_way_through_a_volume_is_the_shortest() -> None:
    """Against Dijkstra's algorithm, written out."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        open_ = rng.random((4, 6, 7)) < 0.6
        world = jx.VoxelGrid.solid(~open_, 0.5)
        voxels = np.argwhere(open_)
        first, last = voxels[rng.integers(len(voxels), size=2)]
        places = (np.array([first, last])[:, ::-1] + 0.5) * 0.5
        if np.linalg.norm(places[0] - places[1]) < 1.0:
            continue
        away, queue = {tuple(first): 0.0}, [(0.0, tuple(first))]
        while queue:
            so_far, here = heapq.heappop(queue)
            if so_far > away[here]:
                continue
            for step in np.ndindex(3, 3, 3):
                by = np.array(step) - 1
                beside = tuple((np.array(here) + by).tolist())
                if min(beside) < 0 or any(np.greater_equal(beside, open_.shape)):
                    continue
                length = so_far + 0.5 * float(np.linalg.norm(by))
                if open_[beside] and length < away.get(beside, math.inf):
                    away[beside] = length
                    heapq.heappush(queue, (length, beside))
        start, nowhere = np.append(places[0], 0.0), np.zeros((0, 3), np.float32)
        site = Site(world, QUADROTOR, None, start, nowhere, open_, ORIGIN)
        found = drive_length(site, places[0], places[1])
        assert found == pytest.approx(away.get(tuple(last), math.inf))


def test_a_dock_in_a_volume_must_be_reached_with_the_charge() -> None:
    with pytest.raises(ValueError, match=r"dock is \(3.1, 0.5, 1.2\), not in a free voxel; accept"):
        scenario(Battery((3.1, 0.5, 1.2)))
    message = (
        r"dock is \(6.5, 0.25, 0.25\), which a robot of radius 0.3 m cannot reach from its start"
    )
    with pytest.raises(ValueError, match=message):
        scenario(Battery((6.5, 0.25, 0.25)))
    small = Battery(DOCK, capacity=0.05, **NUMBERS)
    message = r"dock is \(6.5, 1, 1.2\), 6.0 m from the start, for which the battery of 0.05 Wh"
    with pytest.raises(ValueError, match=message):
        scenario(small)
    with pytest.raises(ValueError, match=r"dock is \[6.5, 1.0\]; accepted: \(x, y, z\)"):
        scenario(Battery((6.5, 1.0)))
    with pytest.raises(
        ValueError, match=r"truths\[0\] is a TrueBattery, and the perception has no"
    ):
        volume(truths=[TrueBattery(BATTERY)])
    sizes = [CAMERA], SIDE, QUADROTOR.radius
    with pytest.raises(ValueError, match=r"window is .* beside the part battery, whose way"):
        jx.VolumePerception(*sizes, window=(20.0, 20.0, 3.0), parts=[BATTERY])
    with pytest.raises(ValueError, match=r"battery is given beside the architecture nearest-clu"):
        build(
            make_settings({"volume": "office3d", "architecture": "nearest-cluster", "battery": {}})
        )
    with pytest.raises(ValueError, match=r"setting battery\.dock"):
        make_settings({"volume": "office3d", "battery": {"dock": [1.0, 2.0]}})
