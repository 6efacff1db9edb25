"""How the robots of a fleet tell one another what they know, at the rates of scans and of maps."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore._equal_objects import Alike
from jaxplore._trees import stack_trees
from jaxplore._types import Count, GridMask, Scalar, StateVector
from jaxplore.belief.obstacles import Obstacles, Plans
from jaxplore.control.base import Info
from jaxplore.control.fleet_share import Share
from jaxplore.dynamics.formation import Formation
from jaxplore.simulation.exploration.moving_discs import MovingDiscs
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.fleet.contact import predict_positions
from jaxplore.simulation.fleet.frames import Frames
from jaxplore.simulation.fleet.parts import gather_parts
from jaxplore.simulation.fleet.radio import Exchanged, Heard, Radio, exchange
from jaxplore.simulation.fleet.rows import others
from jaxplore.simulation.fleet.state import FleetState, Team
from jaxplore.simulation.state import Moment

BESIDE = 1.0
"""Distance that robots keep in view beyond the reach of their plans [m]."""


class Known(NamedTuple):
    """What the robots of a fleet know together.

    `coverage` is the share of the reachable cells that some robot knows to be free, `coverages`
    (N,) that of each. `judged` is that of `FleetState`.
    """

    coverage: Scalar
    coverages: Float[Array, " N"]
    judged: dict[str, Any]


class Talk(NamedTuple):
    """How the robots of a fleet tell one another what they know.

    `share` are the robots that this process computes; `members` of a state are theirs. `identity`
    (N,) is the number of each robot, by which the others are ordered. `radii` (N,) are those of the
    circles that hold the robots [m]. `steps_per_exchange` control periods are between two exchanges
    of maps. Robots tell `plan_length` planned controls, `plan_step` apart [s]. `coordination` is
    how they divide the places among themselves. Unless
    `is_start_known`, robots understand each other only when they have found each other's frames.
    """

    robot: Formation
    explorations: Alike[ExplorationScenario]
    share: Share
    identity: Int[Array, " N"]
    radii: Float[Array, " N"]
    radio: Radio
    steps_per_exchange: Count
    plan_step: Scalar
    plan_length: int
    coordination: str
    is_start_known: bool

    @property
    def members(self) -> tuple[ExplorationScenario, ...]:
        """Exploration of each robot."""
        return self.explorations.all

    def with_others(self, state: ExplorationState, index: int) -> ExplorationState:
        """Return the state of a robot whose belief has the other robots and a map of claims."""
        belief, around = state.belief, Obstacles.unseen(others(self.radii, self.identity, index))
        known = belief.obstacles
        every = around if known is None else known + around
        number = every.outlines.number
        plans = Plans.unknown(number, self.plan_length + 1, self.plan_step)
        every = dataclasses.replace(every, plans=plans)
        claims = None
        if self.coordination != "none":
            claims = jnp.zeros(belief.information.total.shape)
        belief = dataclasses.replace(belief, obstacles=every, claims=claims)
        return state.with_belief(belief)

    def begin(self, members: Sequence[ExplorationState]) -> Team:
        """Return what the robots have told one another at the start: nothing."""
        number = self.share.number
        belief = members[0].belief
        rows, columns = belief.information.total.shape
        nodes = (rows, columns) if self.coordination != "none" else (1, 1)
        # The cells below a robot, which it knows to be free from the start, are news to the others.
        own = self.share.select(self.members)
        priors = tuple(each.map_arrays.prior.probability for each in own)
        return Team(
            Heard.nothing(number, belief.grid.shape, nodes),
            priors,
            jnp.zeros((number, self.plan_length + 1, 2)),
            jnp.zeros((number, 2)),
            jnp.zeros(()),
            jnp.zeros((), jnp.int32),
            self.count_known(members).coverages,
            None if self.is_start_known else Frames.nothing(number),
        )

    def count_known(self, members: Sequence[ExplorationState], time: Scalar | None = None) -> Known:
        """Return what all robots know together; `time` is the time since the start, 0 when None."""
        judging = [each for each in self.members[0].truths if each.is_judging]
        names = [each.name for each in judging]
        rows = self.share.gather(
            [
                (
                    _free_cells(each),
                    each.progress.coverage,
                    {name: known for name, known in each.belief.parts.items() if name in names},
                    {name: each.truths[name] for name in names},
                )
                for each in members
            ]
        )
        known = functools.reduce(jnp.logical_or, [row[0] for row in rows])
        first = self.members[0]
        reachable, number = first.map_arrays.reachable, first.num_reachable
        found = jnp.sum(known & reachable, dtype=jnp.int32).astype(jnp.float32)
        now = jnp.zeros(()) if time is None else time
        known_parts = gather_parts(first, [row[2] for row in rows])
        told, pose = stack_trees([row[3] for row in rows]), first.robot.pose(first.start)
        # The judge looks at what all know together as if one robot had learned it.
        judged = {
            each.name: each.judge(
                each.unite(told[each.name], pose),
                known_parts.get(each.name),
                *(reachable, number, now),
            )
            for each in judging
        }
        return Known(found / number, jnp.stack([row[1] for row in rows]), judged)

    def discs(self, state: FleetState) -> MovingDiscs | None:
        """Return all robots as discs that move; None for a robot alone."""
        if state.team is None:
            return None
        positions = self.robot.positions(state.robot)
        return MovingDiscs(positions, state.team.velocities, self.radii)

    def links(self, state: FleetState, moment: Moment) -> Bool[Array, "N N"]:
        """Return which robots hear and understand each other."""
        positions = self.robot.positions(state.robot)

        def find_seen(one: ExplorationScenario, robot: StateVector) -> Bool[Array, " N"]:
            # What moves hides no robot from the radio.
            truth, pose = one.world_at(lambda: None, moment), one.robot.pose(robot)
            views = [
                sensor.sees(truth.grid, pose, positions, truth.ground) for sensor in one.sensors
            ]
            return jnp.stack(views).any(axis=0)

        sees = self.explorations.each(find_seen, self.robot.split_state(state.robot))
        links = self.radio.links(positions, jnp.stack(sees))
        frames = None if state.team is None else state.team.frames
        # What is told in a frame that the other one does not know says nothing to it.
        return links if frames is None else links & frames.known

    def exchange_when_due(self, state: FleetState, moment: Moment) -> FleetState:
        """Let the robots exchange and merge their maps, if it is time for it."""
        if state.team is None:
            return state
        every = self.steps_per_exchange
        # Two steps before the end of a period: at the usual rates no scan and no update of fields
        # is due then, and the next update of fields reads the merged map.
        is_due = moment.step % every == jnp.maximum(every - 2, 0)
        team = state.team
        observed = self.robot.split_state(known_states(moment))
        poses = [one.robot.pose(each) for one, each in zip(self.members, observed, strict=True)]

        def meet(given: Any) -> Any:
            members, heard, merged, _ = given
            has_ways = self.coordination != "none"
            return tuple(
                exchange(
                    self.radio,
                    self.explorations.at(self.share.mine),
                    self.share,
                    self.identity,
                    members,
                    heard,
                    merged,
                    self.links(state._replace(members=members), moment),
                    self.share.select(poses),
                    moment.step,
                    moment.time,
                    with_lengths=has_ways,
                    with_claims=self.coordination == "claims",
                )
            )

        before = (state.members, team.heard, team.merged, jnp.zeros(()))
        found = Exchanged(*jax.lax.cond(is_due, meet, lambda same: same, before))
        team = team._replace(heard=found.heard, merged=found.merged, sent=found.sent)
        return state._replace(members=found.members, team=team)

    def tell_when_due(self, state: FleetState, team: Team, moment: Moment) -> FleetState:
        """Let the robots tell their positions, velocities and plans after each scan, and count what
        they know together."""
        observed = self.robot.split_state(known_states(moment))
        places = jnp.stack(
            [one.robot.position(each) for one, each in zip(self.members, observed, strict=True)]
        )

        def tell(known: tuple[Obstacles, ...], *_: Any) -> Any:
            links = self.links(state, moment)
            velocities = self._told_velocities(state, observed, team)
            # Each obstacle costs every rollout a distance, so nothing is told of robots that cannot
            # meet.
            near = self._may_meet(places, team.plans)
            after = []
            for index, obstacles in zip(self.share.mine, known, strict=True):
                is_heard = others((links & near)[index], self.identity, index)
                rest = obstacles.outlines.number - is_heard.shape[0]

                def rows(values: Array, i: int = index, first: int = rest) -> Array:
                    """Return the rows of the others, after those of the world's obstacles."""
                    told = others(values, self.identity, i)
                    return jnp.concatenate([jnp.zeros((first, *told.shape[1:])), told])

                heard = jnp.concatenate([jnp.zeros(rest, bool), is_heard])
                zero = jnp.zeros(())
                told = obstacles.update(rows(places), rows(velocities), heard, zero, zero)
                assert told.plans is not None
                plans = told.plans.update(rows(team.plans), heard)
                after.append(dataclasses.replace(told, plans=plans))
            number = jnp.sum(links, dtype=jnp.int32) // 2
            return tuple(after), self.count_known(state.members, moment.time), number

        obstacles = tuple(each.belief.obstacles for each in state.members)
        before = Known(state.coverage, team.coverages, state.judged)
        # Between two scans nothing is told, and what is known together stays as it was: no map is
        # read.
        known, together, links = jax.lax.cond(
            moment.step % self.members[0].steps_per_scan == 0,
            tell,
            lambda *same: same,
            *(obstacles, before, team.links),
        )
        members = tuple(
            each.with_belief(dataclasses.replace(each.belief, obstacles=one))
            for each, one in zip(state.members, known, strict=True)
        )
        team = team._replace(links=links, coverages=together.coverages)
        return state._replace(
            members=members,
            coverage=together.coverage,
            judged=together.judged,
            team=team,
        )

    def _told_velocities(
        self, state: FleetState, known: Sequence[Array], team: Team
    ) -> Float[Array, "N 2"]:
        """Return the velocities (N, 2) [m/s] that the robots tell: they measure their speeds, and
        turn them by the headings that they take themselves to have, of the states `known`."""
        if self.members[0].localisation is None:
            return team.velocities
        true, models = self.robot.split_state(state.robot), self.robot.robots
        turns = [
            one.heading(here) - one.heading(there)
            for one, here, there in zip(models, known, true, strict=True)
        ]
        cos, sin = jnp.cos(jnp.stack(turns)), jnp.sin(jnp.stack(turns))
        x, y = team.velocities.T
        return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=1)

    def _may_meet(
        self, places: Float[Array, "N 2"], plans: Float[Array, "N S 2"]
    ) -> Bool[Array, "N N"]:
        """Return which robots may come close while they carry out their plans.

        The others need no obstacle in a belief, and while a belief has none, its controller
        computes no cost of obstacles.
        """

        def distance(offset: Array) -> Array:
            return jnp.sqrt(jnp.sum(offset * offset, axis=-1))

        reach = distance(plans - places[:, None]).max(axis=-1) + self.radii + BESIDE
        return distance(places[:, None] - places[None, :]) < reach[:, None] + reach[None, :]

    def update_plans(
        self,
        team: Team,
        before: StateVector,
        after: StateVector,
        known: StateVector,
        step: Count,
        info: Info,
    ) -> Team:
        """Return the velocities of the step, and before a scan the plans that will be told.

        `before` and `after` (nx,) are the true states before and after the step, `known` (nx,)
        those in which the robots take themselves to be after it.
        """
        change = self.robot.positions(after) - self.robot.positions(before)
        is_due = (step + 1) % self.members[0].steps_per_scan == 0

        def plan(_: Array) -> Array:
            size = self.plan_length + 1
            states = self.robot.split_state(known)
            return predict_positions(self.robot, states, info.controls, size, self.plan_step)

        plans = jax.lax.cond(is_due, plan, lambda same: same, team.plans)
        return team._replace(plans=plans, velocities=change / self.members[0].control_period)


def known_states(moment: Moment) -> StateVector:
    """Return the states (nx,) in which the robots take themselves to be, which they tell."""
    # A guard that does not trust what its robot observes still expects it somewhere.
    states: StateVector = moment.observed if moment.guard is None else moment.guard.expected
    return states


def _free_cells(state: ExplorationState) -> GridMask:
    """Return the cells (H, W) that count as known to be free by a robot: those of the map of its
    scans at their true poses, if it finds its pose itself."""
    grid, track = state.belief.grid, state.judged.track
    return grid.is_free if track is None else grid.with_probability(track.reference).is_free
