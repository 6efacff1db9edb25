"""What the robots of a fleet learn at a control period, with one compiled body for equal robots."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
from jaxtyping import Array, Int

from jaxplore._alike import Alike
from jaxplore._types import Flag, Key, Pose
from jaxplore.belief.belief import Belief
from jaxplore.belief.obstacles import Obstacles
from jaxplore.simulation.exploration.moving_obstacles import MovingDiscs, MovingObstacles
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.exploration.true_world import TrueWorld
from jaxplore.simulation.fleet.rows import others
from jaxplore.simulation.scenario import Moment


class TeamSenses(NamedTuple):
    """The sensors of the robots of a fleet in the true world, and what updates their beliefs.

    It does what `Senses.perceive` does for each robot. What takes long to compile and reads little
    of the maps, tracking and guidance, is one compiled body for equal robots. Scans and information
    fields change large arrays in place: a loop over robots would copy them, so each robot has a
    part of its own for them.

    Args:
        explorations: exploration of each of the M robots that this process computes.
        places: places of these robots in the fleet.
        identity: (N,) number of each robot, by which the others are ordered.
    """

    explorations: Alike[ExplorationScenario]
    places: tuple[int, ...]
    identity: Int[Array, " N"]

    def perceive(
        self,
        members: Sequence[ExplorationState],
        discs: MovingDiscs | None,
        observed: Sequence[Array],
        moment: Moment,
        keys: Sequence[Key],
    ) -> tuple[ExplorationState, ...]:
        """Let each robot scan, track the others and derive its fields.

        Args:
            members: state of each robot.
            discs: all robots as discs; None for a robot alone.
            observed: state (n,) that each robot observes.
            moment: time and step; the state that is observed is not read.
            keys: random key of the measurements of each robot.
        """
        scenarios = self.explorations.all
        if discs is None:
            one, own = scenarios[0], moment._replace(observed=observed[0])
            truth = one.true_world(members[0], own)
            return (one.senses.perceive(members[0], truth, own, keys[0]),)
        around = [
            jax.tree.map(lambda rows, i=i: others(rows, self.identity, i), discs)
            for i in self.places
        ]
        scanned = []
        for one, each, beside, seen, key in zip(
            scenarios, members, around, observed, keys, strict=True
        ):
            own = moment._replace(observed=seen)
            truth = _among(one.true_world(each, own), each.moving_obstacles, beside)
            scanned.append(one.senses.scanned(each, truth, own, key))
        first = scenarios[0].senses
        states = [each.state for each in scanned]
        known = jax.lax.cond(
            first.is_scan_due(moment.step),
            lambda *given: self._tracked(moment, *given),
            lambda obstacles, *_: obstacles,
            [each.belief.obstacles for each in states],
            [each.moving_obstacles for each in states],
            around,
            [each.robot for each in states],
            [each.is_taken for each in scanned],
            list(keys),
        )
        beliefs = [
            dataclasses.replace(each.state.belief, obstacles=obstacles)
            for each, obstacles in zip(scanned, known, strict=True)
        ]
        beliefs = jax.lax.cond(
            first.are_fields_due(moment.step),
            lambda *given: self._derived(*given),
            lambda same, *_: same,
            *(beliefs, [each.pose for each in scanned], [each.is_placed for each in scanned]),
        )
        return tuple(
            each.state._replace(belief=belief)
            for each, belief in zip(scanned, beliefs, strict=True)
        )

    def _tracked(
        self, moment: Moment, known: Sequence[Obstacles], *rows: Sequence[Any]
    ) -> list[Obstacles]:
        """Return the obstacles of each robot after a measurement of those in sight."""

        def track(
            one: ExplorationScenario,
            obstacles: Obstacles,
            moving: MovingObstacles | None,
            beside: MovingDiscs,
            robot: Array,
            is_taken: Flag,
            key: Key,
        ) -> Obstacles:
            truth = _among(one.world_at(moving, moment), moving, beside)
            pose = one.robot.pose(robot)
            tracked: Obstacles = jax.lax.cond(
                is_taken,
                lambda before: one.senses.tracked(before, truth, pose, key),
                lambda before: before,
                obstacles,
            )
            return tracked

        return self.explorations.each(track, known, *rows)

    def _derived(
        self, beliefs: Sequence[Belief], poses: Sequence[Pose], is_placed: Sequence[Flag]
    ) -> list[Belief]:
        """Return the beliefs with the fields that follow from their maps."""
        informed = [
            jax.lax.cond(
                placed, lambda at, of=one.perception: of.informed(at), lambda same: same, belief
            )
            for one, belief, placed in zip(self.explorations.all, beliefs, is_placed, strict=True)
        ]

        def guide(one: ExplorationScenario, belief: Belief, pose: Pose, placed: Flag) -> Any:
            # Any map of the shape will do: without a goal none is read.
            belief = dataclasses.replace(belief, grid=one.map_arrays.prior)
            after = jax.lax.cond(
                placed,
                lambda same: one.perception.guided(same, pose, one.senses.since_fields),
                lambda same: same,
                belief,
            )
            return after.guidance, after.dwell, after.is_explored, after.pose

        # Guidance reads the clearance and the total information, and the loop need not copy more.
        small = [
            dataclasses.replace(
                each,
                grid=None,
                obstacles=None,
                information=each.information.without_directions(),
            )
            for each in informed
        ]
        found = self.explorations.each(guide, small, poses, is_placed)
        names = ("guidance", "dwell", "is_explored", "pose")
        return [
            dataclasses.replace(belief, **dict(zip(names, fields, strict=True)))
            for belief, fields in zip(informed, found, strict=True)
        ]


def _among(truth: TrueWorld, moving: MovingObstacles | None, around: MovingDiscs) -> TrueWorld:
    """Return the true world with other robots beside its moving obstacles."""
    seen: TrueWorld = eqx.tree_at(
        lambda at: at.moving,
        truth,
        around.beside(moving, truth.time),
        is_leaf=lambda leaf: leaf is None,
    )
    return seen
