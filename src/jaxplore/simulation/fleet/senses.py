"""What the robots of a fleet learn at a control period, with one compiled body for equal robots."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
from jaxtyping import Array, Int

from jaxplore._equal_objects import Alike
from jaxplore._types import Flag, Key, Pose
from jaxplore.belief.belief import Belief
from jaxplore.belief.obstacles import Obstacles
from jaxplore.robot.clock import when_due
from jaxplore.robot.localisation import PoseKnowledge
from jaxplore.robot.robot import tell
from jaxplore.simulation.exploration.moving_discs import MovingDiscs
from jaxplore.simulation.exploration.part_truth import what_moves
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.fleet.rows import others
from jaxplore.simulation.state import Moment


class TeamSenses(NamedTuple):
    """The sensors of the robots of a fleet in the true world, and what updates their beliefs.

    It does what `ExplorationScenario.perceive` does for each robot. What takes long to compile and
    reads little of the maps, tracking and guidance, is one compiled body for equal robots. Scans
    and information fields change large arrays in place: a loop over robots would copy them, so each
    robot has a part of its own for them. `places` are the places in the fleet of the robots that
    this process computes. The others are ordered by `identity` (N,).
    """

    explorations: Alike[ExplorationScenario]
    places: tuple[int, ...]
    identity: Int[Array, " N"]

    def perceive(
        self,
        members: Sequence[ExplorationState],
        discs: MovingDiscs | None,
        moments: Sequence[Moment],
        keys: Sequence[Key],
    ) -> tuple[ExplorationState, ...]:
        """Let each robot scan, track the others and derive its fields.

        `discs` are all robots; None for a robot alone. `moments` are those of each robot.
        """
        scenarios, moment = self.explorations.all, moments[0]
        if discs is None:
            return (scenarios[0].perceive(members[0], moment, keys[0])[0],)
        scanned, around = [], []
        for i, one, each, own, key in zip(
            self.places, scenarios, members, moments, keys, strict=True
        ):
            robots = jax.tree.map(lambda rows, i=i: others(rows, self.identity, i), discs)
            moving = MovingDiscs.join([what_moves(one.truths, each.truths, own.time), robots])
            truth = one.world_at(eqx.Partial(MovingDiscs.join, (moving,)), own)
            scanned.append(one.sense(each, truth, own, key, is_told=False))
            around.append(moving)
        rates = scenarios[0].rates
        states = [each.state for each in scanned]
        known = jax.lax.cond(
            rates.is_scan_due(moment.step),
            lambda *given: self._track_obstacles(moment, *given),
            lambda obstacles, *_: obstacles,
            [each.belief.obstacles for each in states],
            around,
            [each.robot for each in states],
            [each.sight.is_taken for each in scanned],
            [_known_pose(each.state) for each in scanned],
            list(keys),
        )
        is_due = rates.are_fields_due(moment.step)
        sights = [each.sight.correct(each.state.own.place) for each in scanned]
        beliefs: list[Belief] = []
        for one, sensed, obstacles in zip(scenarios, scanned, known, strict=True):
            belief = dataclasses.replace(sensed.state.belief, obstacles=obstacles)
            inform = functools.partial(_update_information, one, sensed.state.own.place)
            beliefs += when_due(is_due, sensed.sight.is_placed, inform, (belief,))
        # What reads an information field is apart from what changes it in place: within one branch
        # XLA would copy the field of every robot, twice.
        guided = jax.lax.cond(
            is_due,
            self._update_guidance,
            lambda beliefs, *_: [_guidance(each, self._errands) for each in beliefs],
            beliefs,
            [each.pose for each in sights],
            [each.is_placed for each in sights],
        )
        return tuple(
            each.state.with_belief(
                dataclasses.replace(belief.with_parts(fields.pop("parts")), **fields)
            )
            for each, belief, fields in zip(scanned, beliefs, guided, strict=True)
        )

    @property
    def _errands(self) -> tuple[str, ...]:
        """Names of the parts that send robots somewhere."""
        parts = self.explorations.kinds[0].perception.parts
        return tuple(part.name for part in parts if part.has_errands)

    def _track_obstacles(
        self, moment: Moment, known: Sequence[Obstacles], *rows: Sequence[Any]
    ) -> list[Obstacles]:
        """Return the obstacles of each robot after a measurement of those in sight."""

        def track(
            one: ExplorationScenario,
            obstacles: Obstacles,
            moving: MovingDiscs,
            robot: Array,
            is_taken: Flag,
            place: Pose | None,
            key: Key,
        ) -> Obstacles:
            truth = one.world_at(eqx.Partial(MovingDiscs.join, (moving,)), moment)
            pose = one.robot.pose(robot)

            def update(before: Obstacles) -> Obstacles:
                told = truth.tell(one.sensors, pose, one.tracking_noise, key)
                return before if told is None else tell(before, told, place)

            tracked: Obstacles = jax.lax.cond(is_taken, update, lambda before: before, obstacles)
            return tracked

        return self.explorations.each(track, known, *rows)

    def _update_guidance(
        self, beliefs: Sequence[Belief], poses: Sequence[Pose], is_placed: Sequence[Flag]
    ) -> list[dict[str, Any]]:
        """Return the guidance of each robot, and what else follows from its information."""

        def guide(one: ExplorationScenario, belief: Belief, pose: Pose, placed: Flag) -> Any:
            if belief.grid is None:
                # Any map of the shape will do: without a goal none is read.
                belief = dataclasses.replace(belief, grid=one.map_arrays.prior)
            after: Belief = jax.lax.cond(
                placed,
                lambda same: one.perception.update_guidance(same, pose, one.rates.since_fields),
                lambda same: same,
                belief,
            )
            return _guidance(after, self._errands)

        # Guidance reads the clearance and the total information, and the loop need not copy more.
        absent: dict[str, Any] = {"obstacles": None}
        if self.explorations.kinds[0].goal is None:
            absent["grid"] = None
        small = [
            dataclasses.replace(
                each,
                information=each.information.without_directions(),
                parts={name: each.parts[name] for name in self._errands},
                **absent,
            )
            for each in beliefs
        ]
        return self.explorations.each(guide, small, poses, is_placed)


def _known_pose(state: ExplorationState) -> Pose | None:
    """Return the pose that a robot has found; None if its odometry tells it."""
    return None if state.own.place is None else state.own.place.known.pose


def _update_information(
    one: ExplorationScenario, place: PoseKnowledge | None, belief: Belief
) -> tuple[Belief]:
    """Return the belief of a robot with the information field of its map.

    `place` is what it knows of its pose; None if its odometry tells it.
    """
    if one.localisation is not None and place is not None:
        belief = one.localisation.inform(place, belief)
    return (one.perception.update_information(belief),)


def _guidance(belief: Belief, errands: Sequence[str]) -> dict[str, Any]:
    """Return the fields of a belief that an update of its guidance changes, and of its parts those
    with errands."""
    names = ("guidance", "dwell", "is_explored", "pose", *(("goal", "is_sent") if errands else ()))
    fields = {name: getattr(belief, name) for name in names}
    return {**fields, "parts": {name: belief.parts[name] for name in errands}}
