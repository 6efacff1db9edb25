"""The fields of a belief that planning reads, as they follow from its map."""

import dataclasses
import functools
import operator
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._types import Flag, GridMask, GridValues, Pose, Position, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.belief.dwell import add_dwell, dwell_discount, with_given_up
from jaxplore.belief.exploration_field import GOAL_DETOUR, exploration_field, leads_to_goal
from jaxplore.belief.goal_field import goal_field
from jaxplore.belief.guidance import GuidanceField
from jaxplore.belief.part import Errand, Part
from jaxplore.belief.roadmap import Locomotion
from jaxplore.belief.zones import unknown_fraction
from jaxplore.information.field import InformationField
from jaxplore.information.field_sensor import FieldSensor
from jaxplore.maps.field import ScalarField
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel

IGNORED = 1e-4
"""Probability of occupancy of what is unknown where the robot must not be: a beam through ten
metres of it loses one per cent, and has no information of it."""


class BeliefFields(eqx.Module):
    """Updates the information and guidance fields of a belief. `Perception`, which makes the map,
    has the numbers and the parts."""

    sensors: tuple[Sensor, ...]
    sensor_model: InverseSensorModel
    field_sensor: FieldSensor
    locomotion: Locomotion
    max_clearance: float = eqx.field(static=True)
    required_clearance: Scalar
    decay_length: Scalar
    min_information: Scalar
    occupancy_prior: Scalar
    patience: Scalar
    memory: Scalar
    goal: Position | None
    goal_heading: Scalar | None
    max_unknown: Scalar
    ground: Ground | None
    parts: tuple[Part, ...]
    unknown_factor: Scalar
    is_goal_apart: bool = eqx.field(static=True)
    is_batched: bool = eqx.field(static=True)

    def update_fields(self, belief: Belief, pose: Pose, elapsed: Scalar) -> Belief:
        """Update the information and guidance fields of the belief.

        Args:
            belief: belief after the last scan.
            pose: present pose (x, y, yaw) of the robot [m, m, rad].
            elapsed: time since the last update [s].

        Raises:
            ValueError: an argument of another kind or shape.
        """
        return self.update_guidance(self.update_information(belief), pose, elapsed)

    @_kinds.check_arguments
    def update_information(self, belief: Belief) -> Belief:
        """Return the belief with the information field of its map; see `update_fields`.

        Places that looks take away are given up if nothing new was seen for `memory`, where the
        belief has a `gain`.

        Raises:
            ValueError: something else than a belief.
        """
        # What parts add is in the last field, and an update would keep it.
        is_added = any(part.adds_information for part, _ in self._list_active(belief.parts))
        before = None if is_added else belief.information
        information = self._information(belief, before)
        dwell = belief.dwell
        if belief.gain is not None:
            looks = belief.information.total, information.total
            left = with_given_up(dwell, *looks, self.min_information, self.patience)
            # Scans from poses with errors contradict each other at walls: from one place the robot
            # sees through a thin wall, from the next one it does not. It would forget each view at
            # the other, and go to and fro between both for ever.
            dwell = jnp.where(belief.gain.since >= self.memory, left, dwell)
        return dataclasses.replace(belief, information=information, dwell=dwell)

    @_kinds.check_arguments
    def update_guidance(self, belief: Belief, pose: Pose, elapsed: Scalar) -> Belief:
        """Return the belief with the fields that follow from its information; see `update_fields`.

        Args:
            belief: belief with the information field of its map.
            pose: present pose (x, y, yaw) of the robot [m, m, rad].
            elapsed: time since the last update [s].

        Raises:
            ValueError: an argument of another kind or shape.
        """
        pose = _checks.pose("pose", pose)
        _checks.of_shape("elapsed", elapsed, ())
        information = belief.information
        dwell = add_dwell(belief.dwell, information.frame, pose, elapsed, self.memory)
        if belief.gain is not None:
            known = 1.0 - unknown_fraction(belief.grid)
            gain = belief.gain.update(known, elapsed, belief.is_sent)
            belief = dataclasses.replace(belief, gain=gain)
        return self._derive_fields(belief, information, dwell, pose)

    def _derive_fields(
        self, belief: Belief, information: InformationField, dwell: GridValues, pose: Pose
    ) -> Belief:
        """Return the belief with the fields that follow from its map and the information."""
        states = self._plan_errands(belief, pose)
        errand = self._errand(states)
        guidance, is_explored = self._make_guidance(
            belief.grid,
            belief.clearance,
            information,
            dwell,
            pose,
            belief.claims,
            belief.revisit,
            errand,
        )
        return dataclasses.replace(
            belief,
            information=information,
            guidance=guidance,
            dwell=dwell,
            is_explored=is_explored,
            # A lost robot has no finite pose. Costs measure from the last finite one.
            pose=jnp.where(jnp.isfinite(pose).all(), pose, belief.pose),
            to_goal=self._to_goal(belief.grid, belief.parts, pose),
            parts=states,
            goal=self._next_goal(errand),
            is_sent=None if errand is None else errand.is_due,
        )

    def _plan_errands(self, belief: Belief, pose: Pose) -> dict[str, Any]:
        """Return the states of parts, with the decisions whether their errands are due."""
        states = dict(belief.parts)
        for part, own in self._list_active(belief.parts):
            errand = part.errand(own) if part.has_errands else None
            if errand is not None:
                way = exploration_field(
                    belief.clearance,
                    jnp.zeros_like(belief.dwell),
                    self.required_clearance,
                    self.locomotion,
                    decay_length=self.decay_length,
                    min_information=self.min_information,
                    stride=self.field_sensor.stride,
                    goal=errand.place,
                    is_explored=jnp.array(True),
                    start=pose[:2],
                    goal_detour=0.0,
                ).from_pose(pose)
                cost = way(pose[:2])
                cost = jnp.where(cost < way.outside, cost, jnp.inf)
                states[part.name] = part.plan_errand(own, cost)
        return states

    def _errand(self, states: Mapping[str, Any]) -> Errand | None:
        """Return the errand of the first part for which one is due; None without errands."""
        found: Errand | None = None
        for part, own in reversed(self._list_active(states)):
            errand = part.errand(own)
            if errand is not None and found is not None:
                place = jnp.where(errand.is_due, errand.place, found.place)
                errand = Errand(place, errand.is_due | found.is_due)
            found = found if errand is None else errand
        return found

    def _next_goal(self, errand: Errand | None) -> Position | None:
        """Return where the robot shall come to rest: the place of an errand that is due, or the
        goal; None without both."""
        if errand is None or self.goal is None:
            return self.goal if errand is None else errand.place
        return jnp.where(errand.is_due, errand.place, self.goal)

    def find_forbidden(self, belief: Belief) -> GridMask | None:
        """Return the cells (H, W) that parts of the robot forbid to enter; None if none does."""
        return self._find_cells_closed_by_parts(belief.parts)

    def _find_cells_closed_by_parts(self, states: Mapping[str, Any]) -> GridMask | None:
        """Return the cells (H, W) that parts forbid to enter; None if none does."""
        given = [part.closed_cells(own) for part, own in self._list_active(states)]
        masks = [each for each in given if each is not None]
        return functools.reduce(operator.or_, masks) if masks else None

    def _list_active(self, states: Mapping[str, Any]) -> list[tuple[Part, Any]]:
        """Return the parts that have a state, each with its own."""
        return [(part, states[part.name]) for part in self.parts if part.name in states]

    def _information(self, belief: Belief, before: InformationField | None) -> InformationField:
        """Return the information field, updated from the last one if that suffices."""
        field = self._cell_information(belief.grid, belief.parts, before)
        for part, own in self._list_active(belief.parts):
            field = part.add_information(own, field, belief.grid, self.sensors[0])
        return field

    def _cell_information(
        self, grid: OccupancyGrid, states: Mapping[str, Any], before: InformationField | None
    ) -> InformationField:
        """Return the information field without what parts add to it beside their interest."""
        prior, closed = self.occupancy_prior, self._find_cells_closed_by_parts(states)
        if closed is not None:
            # What is unknown where the robot must not be counts as free, so it sees through it.
            is_ignored = closed & ~(grid.is_free | grid.is_occupied)
            grid = grid.with_probability(jnp.where(is_ignored, IGNORED, grid.probability))
        given = [part.interest(own) for part, own in self._list_active(states)]
        interests = [each for each in given if each is not None]
        if interests:
            # The interest of every cell changes with time, so the whole field is recomputed.
            interest = functools.reduce(operator.add, interests)
            return self.field_sensor.field(grid, self.sensor_model, interest, prior=prior)
        if before is None or self.is_batched:
            return self.field_sensor.field(grid, self.sensor_model, prior=prior)
        return self.field_sensor.update(before, grid, self.sensor_model, prior=prior)

    def _to_goal(
        self, grid: OccupancyGrid, states: Mapping[str, Any], pose: Pose
    ) -> GuidanceField | None:
        if not self.is_goal_apart or self.goal is None:
            return None
        closed = self._find_cells_closed_by_parts(states)
        return self.way_to(self.goal, grid, pose, self.goal_heading, closed)

    def way_to(
        self,
        goal: Position,
        grid: OccupancyGrid,
        pose: Pose,
        heading: Scalar | None = None,
        closed: GridMask | None = None,
    ) -> GuidanceField:
        """Return the cost-to-go to a goal; see `jaxplore.belief.goal_field`.

        Args:
            goal: goal position (x, y) [m].
            grid: the robot's map.
            pose: pose (x, y, yaw) of the robot [m, m, rad].
            heading: heading at the goal [rad]; any when absent.
            closed: (H, W) cells that may not be entered; none when absent.
        """
        if self.ground is not None:
            blocked = ~self.ground.is_traversable
            closed = blocked if closed is None else closed | blocked
        return goal_field(
            grid,
            closed,
            goal,
            self.required_clearance,
            self.locomotion,
            unknown_factor=self.unknown_factor,
            max_clearance=self.max_clearance,
            stride=self.field_sensor.stride,
            start=pose[:2],
            heading=heading,
        ).from_pose(pose)

    def _make_guidance(
        self,
        grid: OccupancyGrid,
        clearance: ScalarField,
        information: InformationField,
        dwell: GridValues,
        pose: Pose,
        claims: GridValues | None = None,
        revisit: GridValues | None = None,
        errand: Errand | None = None,
    ) -> tuple[GuidanceField, Flag]:
        """Return the guidance, and whether it leads to a goal: because the map counts as explored,
        or on an errand."""
        worth = information.total
        if revisit is not None:
            worth = worth + revisit
        # It gives up what it waits for in vain, information or a place that it does not recognise.
        worth = worth * dwell_discount(dwell, self.patience)
        is_known = is_goal_next = jnp.array(False)
        if self.goal is not None:
            is_known = unknown_fraction(grid) < self.max_unknown
        goal, detour = None if self.is_goal_apart else self.goal, jnp.asarray(GOAL_DETOUR)
        heading = None if self.is_goal_apart else self.goal_heading
        is_next = is_known
        if errand is not None:
            # Without a goal of its own, the place is no source while the robot explores.
            detour = detour if goal is not None else jnp.where(errand.is_due, detour, jnp.inf)
            goal = errand.place if goal is None else jnp.where(errand.is_due, errand.place, goal)
            is_next = is_known | errand.is_due
        guidance = exploration_field(
            clearance,
            worth,
            self.required_clearance,
            self.locomotion,
            decay_length=self.decay_length,
            min_information=self.min_information,
            stride=self.field_sensor.stride,
            goal=goal,
            goal_heading=heading,
            is_explored=is_next,
            start=pose[:2],
            claims=claims,
            goal_detour=detour,
        ).from_pose(pose)
        if self.goal is not None and not self.is_goal_apart:
            is_goal_next = leads_to_goal(guidance, pose[:2])
        return guidance, is_next | is_goal_next
