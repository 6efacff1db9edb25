"""What a robot measures in the true world."""

import itertools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Key
from jaxplore.robot.clock import when_due
from jaxplore.robot.robot import Measurement, Robot, Told
from jaxplore.sensing.beams import Scan
from jaxplore.sensing.mount import ScanMotion
from jaxplore.simulation.exploration.part_truth import PartTruth
from jaxplore.simulation.exploration.rates import Rates
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.exploration.true_world import TrueWorld
from jaxplore.simulation.state import Moment


class Instruments(NamedTuple):
    """Turns the truth into what a robot is given of it.

    `truths` are what is true of its parts. `tracking_noise` are standard deviations of the
    positions [m] and velocities [m/s] of moving obstacles of which it is told.
    """

    onboard: Robot
    rates: Rates
    truths: tuple[PartTruth, ...]
    tracking_noise: Float[Array, "2"]

    def measure(
        self,
        state: ExplorationState,
        truth: TrueWorld,
        moment: Moment,
        key: Key,
        *,
        is_told: bool = True,
    ) -> tuple[Measurement, Float[Array, " B"]]:
        """Return what the robot measures, and the ranges of its newest scans (B,) [m].

        Odometry faults are in the observed state of the moment: the scan is taken at the true pose
        and mapped at the observed one, so they distort the map. `is_told` says whether a robot that
        finds no moving obstacles itself is told of them; static.
        """
        robot, rates = self.onboard, self.rates
        pose, sensors = robot.model.pose(state.robot), robot.sensors
        is_told = is_told and robot.perception.tracker is None

        def take() -> tuple[Array, Array, Told | None, dict[str, Any]]:
            scans = truth.scans(sensors, pose, key, self.scan_motion(state, moment))
            ranges, is_return = (jnp.concatenate(each) for each in zip(*scans, strict=True))
            told = truth.tell(sensors, pose, self.tracking_noise, key) if is_told else None
            looks = {}
            for each in self.truths:
                part = robot.perception.part_named(each.name)
                own = state.truths.get(each.name)
                looks[each.name] = each.measure(part, own, truth, sensors, pose, key)
            looks = {name: look for name, look in looks.items() if look is not None}
            return ranges, is_return, told, looks

        is_due = rates.is_scan_due(moment.step)
        # What is not due is not read.
        blank = jax.tree.map(
            lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), eqx.filter_eval_shape(take)
        )
        ranges, is_return, told, looks = when_due(
            is_due,
            ~moment.is_blind,
            lambda *_: take(),
            (state.ranges, *blank[1:]),
        )
        ends = list(itertools.accumulate(sensor.num_beams for sensor in sensors))
        split = (jnp.split(each, ends[:-1]) for each in (ranges, is_return))
        scans = tuple(itertools.starmap(Scan, zip(*split, strict=True)))
        seen = moment.observed if moment.measured is None else moment.measured
        measured = Measurement(
            robot.model.pose(seen),
            moment.is_blind,
            scans,
            is_due,
            rates.since_scan,
            rates.are_fields_due(moment.step),
            rates.since_fields,
            rates.period,
            moment.time,
            moment.guard,
            told,
            looks,
        )
        return measured, ranges

    def scan_motion(self, state: ExplorationState, moment: Moment) -> ScanMotion | None:
        """Return the motion of the robot during a scan; None if no lidar turns."""
        if state.control is None:
            return None
        model = self.onboard.model
        # A guard may observe no pose. The velocity is that in the frame of the robot, at any pose.
        seen = moment.observed if moment.measured is None else moment.measured
        known = model.with_pose(seen, jnp.zeros(3))
        true, known = (model.twist(each, state.control) for each in (state.robot, known))
        return ScanMotion(true, known, self.rates.since_scan)
