"""The exploration of an unknown world by a fleet of robots."""

import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplore import _checks, _kinds
from jaxplore._describe import describe_fields
from jaxplore._equal_objects import Alike
from jaxplore._trees import HostOnly, with_field
from jaxplore._types import ArrayLike, ControlVector, Count, Flag, Key, Rows, Scalar, StateVector
from jaxplore._xla import on_device
from jaxplore.belief.gain import Gain
from jaxplore.control.base import Controller, Info
from jaxplore.control.fleet_controller import FleetBelief, robot_keys
from jaxplore.control.fleet_share import Share, check_share
from jaxplore.control.guard import MotionGuard, ScanPoints
from jaxplore.dynamics.formation import Formation, extent
from jaxplore.report.exploration.data import TEAM, ExplorationFrame, ExplorationRecord
from jaxplore.report.exploration.metrics import ExplorationMetrics
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.report.exploration.team import TeamRecord
from jaxplore.report.recording import Frame
from jaxplore.robot.clock import whole_steps
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.disturbances import Disturbance
from jaxplore.simulation.exploration.part_truth import PartTruth, init_truths
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.fleet.assignment import with_assignments
from jaxplore.simulation.fleet.checks import check_disturbances, check_members, identities
from jaxplore.simulation.fleet.closing import close_loops
from jaxplore.simulation.fleet.communication import Talk, known_states
from jaxplore.simulation.fleet.contact import find_room, stop_touching
from jaxplore.simulation.fleet.disturbances import FleetDisturbances
from jaxplore.simulation.fleet.driver import FleetDriver
from jaxplore.simulation.fleet.frames import SEARCH_PERIOD, find_frames
from jaxplore.simulation.fleet.radio import Radio
from jaxplore.simulation.fleet.recording import fleet_frame, make_fleet_recording
from jaxplore.simulation.fleet.records import stack_records
from jaxplore.simulation.fleet.senses import TeamSenses
from jaxplore.simulation.fleet.starts import check_starts
from jaxplore.simulation.fleet.state import FleetState
from jaxplore.simulation.scenario import Inspect, Scenario
from jaxplore.simulation.state import LoopState, Moment

COORDINATIONS = ("claims", "assignment", "none")
"""Ways in which the robots of a fleet divide the places among themselves."""


class Fleet(Scenario):
    """Exploration of an unknown world by N robots, each with sensors and a belief of its own.

    - **Maps.** At the exchange rate, robots within the radio range of each other, or in sight, pass
      on all that they have heard, and merge it (`jaxplore.belief.merging`): nothing is counted
      twice, in whatever order and over whichever robots it arrives.
    - **Motion.** The others are moving obstacles. They hide what is behind them from a sensor, and
      are no part of the map. A robot knows those in sight by its tracker, and those that it hears
      by their own word, with the plan of their last command, at every scan. A robot that would
      touch another one stops, and the step counts as a contact.
    - **Coordination.** With `claims`, a place to which another robot has a shorter path is worth
      less (`jaxplore.belief.claims`). With `assignment`, every robot assigns clusters of frontier
      cells to itself and to those that it has heard by the shortest sum of paths. With `none`, the
      robots only share maps. All rest on what was heard by radio; with `is_central` in the radio
      everybody hears everybody.
    - **Frames.** Without `is_start_known` no robot knows where the others have begun. Robots within
      the radio range match their maps every 5 s (`jaxplore.localisation.match_maps`). Once it is
      certain how these lie, the robots understand what they tell each other, and those that they
      already understood do as well.

    The exploration is finished when the share of the reachable cells that some robot knows to be
    free is the target coverage, and given up as that of one robot is. With targets it is finished
    when each one was found by some robot, and not given up. On a patrol it ends with the time
    limit. What parts of the robots know is merged with the maps (`Part.merge`). Numbers that
    concern all, the rates, the target coverage, the times without scans, are those of the first
    robot's exploration.

    With a goal it is finished when one robot is there, and the robots together know the target
    coverage, or that robot has nothing left to explore (`Belief.is_explored`), or all targets were
    found. They explore first, as one robot with a goal does.

    A fleet of one robot runs as that robot alone does, to the bit. The order of the robots does not
    matter: keys are derived from the order of the starts by x, y and yaw.

    Args:
        robots: exploration of each robot, in one world; or that of one robot, for a fleet of equal
            ones. Without a target coverage they have 0.99. All have the same goal and the same
            parts, a guard or none, a chassis or none, and a localisation or none.
        starts: (N, 3) start pose (x, y, yaw) of each robot [m, m, rad], at rest; those of the
            explorations when absent.
        radio: who hears whom; `Radio()` when absent.
        exchange_rate: rate of exchanges of maps [Hz]; a whole fraction of the control rate.
        coordination: `claims`, `assignment` or `none`; static.
        plan_step: time between the planned controls of the robots' controllers [s].
        plan_length: number of planned controls that robots tell; static.
        is_start_known: whether robots know from the start where the others have begun; static.

    Raises:
        ValueError: a part of another class, explorations that a fleet does not support, robots in
            different worlds or with different rates, starts that are off the map, in a wall, or so
            close that robots touch; an exchange rate that is no whole fraction.
    """

    frame_type = ExplorationFrame
    metrics_type = ExplorationMetrics

    explorations: Alike[ExplorationScenario]
    robot: Formation
    start: StateVector
    control_period: Scalar
    radio: Radio
    steps_per_exchange: Count
    identity: Int[Array, " N"]
    radii: Float[Array, " N"]
    share: Share
    plan_step: Scalar
    plan_length: int = eqx.field(static=True)
    coordination: str = eqx.field(static=True)
    is_start_known: bool = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        robots: ExplorationScenario | Sequence[ExplorationScenario],
        starts: Rows | None = None,
        *,
        radio: Radio | None = None,
        exchange_rate: float = 1.0,
        coordination: str = "claims",
        plan_step: ArrayLike = 0.05,
        plan_length: int = 40,
        is_start_known: bool = True,
    ) -> None:
        members = check_members(robots, starts)
        self.explorations = Alike(members).map(ExplorationScenario.with_target_coverage)
        if len(members) > 1:
            # The others tell where they are, so there is nothing to be found in scans.
            told = self.explorations.map(ExplorationScenario.with_told_obstacles)
            self.explorations = told
        first = self.members[0]
        poses = check_starts(self.members, starts)
        self.robot = Formation([each.robot for each in self.members])
        states = [
            # A start that is not given stays the exploration's own, with its altitude.
            np.asarray(one.start if starts is None else one.robot.at_pose(*pose.tolist()))
            for one, pose in zip(self.members, poses, strict=True)
        ]
        self.start = on_device(np.concatenate(states))
        self.control_period = first.control_period
        self.placed = HostOnly(first.datum)
        self.radio = Radio() if radio is None else radio
        rate = 1.0 / first.period
        self.steps_per_exchange = whole_steps("exchange_rate", exchange_rate, rate)
        if coordination not in COORDINATIONS:
            raise ValueError(
                f"coordination is {coordination!r}; accepted: {', '.join(COORDINATIONS)}"
            )
        self.coordination = coordination
        self.identity = on_device(identities(poses))
        radii = [extent(each.robot.footprint) for each in self.members]
        self.radii = on_device(np.asarray(radii, np.float32))
        self.share = Share.whole(self.num_robots)
        self.plan_step = _checks.scalar("plan_step", plan_step, above=0.0)
        self.plan_length = _checks.positive_int("plan_length", plan_length)
        self.is_start_known = _kinds.flag("is_start_known", is_start_known)

    def __repr__(self) -> str:
        return describe_fields(self, "members", "coordination", "period")

    @property
    def members(self) -> tuple[ExplorationScenario, ...]:
        """Exploration of each robot."""
        return self.explorations.all

    @property
    def num_robots(self) -> int:
        """Number of robots, N."""
        return len(self.explorations.kind_of)

    def with_share(self, share: Share) -> "Fleet":
        """Return the fleet in a process that computes some of its robots.

        Args:
            share: these robots, and how to hear of the others.

        Raises:
            ValueError: robots that are not all equal, or one alone.
        """
        check_share(share, self.explorations.kinds, "robots")
        first = self.members[0]
        given: dict[str, Any] = {
            "localisation": first.localisation,
            "goal": first.goal,
            "carried_at": first.disturbances.is_carrying or None,
        }
        given |= {each.name: each for each in first.truths if each.is_moving}
        for name, one in given.items():
            if one is not None:
                raise ValueError(
                    f"{name} of the robots is given; accepted in several processes: none"
                )
        if not self.is_start_known:
            raise ValueError("is_start_known is False; accepted in several processes: True")
        return with_field(self, "share", share)

    @property
    def metric_groups(self) -> tuple[str, ...]:
        """Names of the truths of parts, and of what the robots share: groups of metrics."""
        return (*self.members[0].metric_groups, TEAM)

    @property
    def _judging(self) -> tuple[PartTruth, ...]:
        """Truths that judge what the robots know together."""
        return tuple(each for each in self.members[0].truths if each.is_judging)

    @property
    def steps_per_measurement(self) -> int:
        """Control periods between two scans."""
        return self.members[0].steps_per_measurement

    @property
    def cell_size(self) -> float:
        """Side of a cell of the map [m]."""
        return self.members[0].cell_size

    @property
    def objective(self) -> str:
        """Default objective: that of one robot, plus contacts."""
        return f"{self.members[0].objective} + 100*{TEAM}.contacts"

    @property
    def steps_per_revision(self) -> int | None:
        """Control periods between two assignments or searches; None without any."""
        every = [each for each in self._revisions if each is not None]
        return math.gcd(*every) if every else None

    @property
    def _revisions(self) -> tuple[int | None, ...]:
        """Control periods between two assignments, two searches for frames, and of each robot
        between two searches for loops."""
        has_clusters = self.coordination == "assignment" and self.num_robots > 1
        assignments = int(self.steps_per_exchange) if has_clusters else None
        searches = None
        if not self.is_start_known and self.num_robots > 1:
            searches = round(SEARCH_PERIOD / float(self.control_period))
        return (assignments, searches, *(each.steps_per_revision for each in self.members))

    def update_on_host(self, state: LoopState) -> LoopState:
        """Return the state after work on the host: maps moved where a robot has closed a loop, and
        clusters of frontier cells assigned anew, and frames of other robots found."""
        step, (assignments, searches, *closings) = int(state.step), self._revisions
        for index, every in enumerate(closings):
            if every is not None and step % every == 0:
                state = close_loops(self.members, self.robot, self.identity, state, index)
        if searches is not None and step % searches == 0:
            state = state._replace(task=self._with_frames(state.task, step))
        if assignments is None or step % assignments:
            return state
        task: FleetState = state.task
        assert task.team is not None
        members = with_assignments(
            self.share.select(self.members), task.members, self.share.mine, task.team.heard
        )
        return state._replace(task=task._replace(members=members))

    def _with_frames(self, task: FleetState, step: int) -> FleetState:
        """Return the state after the robots that hear each other have matched their maps."""
        team = task.team
        assert team is not None
        assert team.frames is not None
        if np.asarray(team.frames.known).all():
            return task
        positions = self.robot.positions(task.robot)
        links = self.radio.links(positions, jnp.zeros((self.num_robots,) * 2, bool))
        frames = find_frames(
            team.frames,
            [each.belief.grid for each in task.members],
            np.asarray(links),
            np.asarray(self.identity),
            step * float(self.control_period),
        )
        return task._replace(team=team._replace(frames=frames))

    def measure_state(self, state: FleetState) -> StateVector:
        """Return the states (nx,) that the robots take to be their own; see `Localisation`."""
        if self.members[0].localisation is None:
            return state.robot
        pairs = zip(self.members, state.members, strict=True)
        return jnp.concatenate([one.measure_state(each) for one, each in pairs])

    def init(self, key: Key | None) -> tuple[FleetState, FleetBelief]:
        """Return the initial state, and the beliefs with the prior map."""
        members, starts = [], self.robot.split_state(self.start)

        def begin(
            one: ExplorationScenario, start: StateVector, own_key: Key | None
        ) -> ExplorationState:
            here: ExplorationScenario = eqx.tree_at(lambda each: each.start, one, start)
            # What moves in the world is the same for all, what a robot measures is its own.
            truths = init_truths(here.truths, here.robot.pose(start), key)
            return here.init(own_key)[0]._replace(truths=truths)

        # One compiled body for equal robots: once in a run, copies of their maps do not matter.
        own = self.explorations.at(self.share.mine)
        keys = [None] * self.num_robots if key is None else robot_keys(key, self.identity)
        begun = own.each(begin, self.share.select(starts), self.share.select(keys))
        for index, alone in zip(self.share.mine, begun, strict=True):
            members.append(alone if self.num_robots == 1 else self._talk.with_others(alone, index))
        known = self._talk.count_known(members)
        state = FleetState(
            self.start,
            tuple(members),
            known.coverage,
            Gain(known.coverage, jnp.zeros(())),
            jnp.zeros((), jnp.int32),
            self._talk.begin(members) if self.num_robots > 1 else None,
            known.judged,
        )
        return state, self._belief(state)

    def perceive(
        self, state: FleetState, moment: Moment, key: Key
    ) -> tuple[FleetState, FleetBelief]:
        """Let each robot scan and derive its fields, and let the robots tell what they know."""
        state = self._talk.exchange_when_due(state, moment)
        own = self.share.select
        here = TeamSenses(self.explorations.at(self.share.mine), self.share.mine, self.identity)
        members = here.perceive(
            state.members,
            self._talk.discs(state),
            self._own_moments(moment),
            own(robot_keys(key, self.identity)),
        )
        known = state._replace(members=members)
        if known.team is None:
            alone = members[0]
            judged = {name: alone.truths[name] for name in known.judged}
            known = known._replace(coverage=alone.progress.coverage, judged=judged)
        else:
            known = self._talk.tell_when_due(known, known.team, moment)
        # While a robot is charged, nothing new may be seen.
        sent = [each.belief.is_sent for each in known.members if each.belief.is_sent is not None]
        is_sent = jnp.stack(sent).any() if sent else None
        gain = state.gain.update(known.coverage, self.control_period, is_sent)
        known = known._replace(gain=gain)
        return known, self._belief(known)

    # One for each robot, behind the methods of one.
    def driver(  # type: ignore[override]
        self, controller: Controller | None = None
    ) -> FleetDriver:
        """Return what decides the commands of all robots; see `Scenario.driver`."""
        return FleetDriver(self.explorations, self.share, self.robot, controller)

    @property
    def disturbances(self) -> FleetDisturbances:  # type: ignore[override]
        """What each true robot differs by from its model, and what fails."""
        robots = tuple(each.disturbances for each in self.members)
        return FleetDisturbances(self._model, robots, self.identity)

    @property
    def _model(self) -> Formation:
        """Models of the robots, by which they plan; `robot` may be others that are true."""
        return Formation([each.robot for each in self.members])

    def scan_points(  # type: ignore[override]
        self, state: FleetState, moment: Moment | None = None
    ) -> tuple[ScanPoints, ...]:
        """Return the newest scan of each robot that this process computes."""
        own = self.share.select(self.members)
        return tuple(
            one.scan_points(each, moment) for one, each in zip(own, state.members, strict=True)
        )

    def _own_moments(self, moment: Moment) -> tuple[Moment, ...]:
        """Return the moment of each robot that this process computes."""
        states = self.share.select(self.robot.split_state(moment.observed))
        own = tuple(moment._replace(observed=each) for each in states)
        if moment.measured is None or moment.guard is None:
            return own
        measured = self.share.select(self.robot.split_state(moment.measured))
        return tuple(
            each._replace(measured=state, guard=judged)
            for each, state, judged in zip(own, measured, moment.guard.robots, strict=True)
        )

    def advance(
        self, state: FleetState, control: ControlVector, moment: Moment, info: Info
    ) -> tuple[FleetState, ExplorationRecord]:
        """Move the robots and record the step.

        A robot that would touch something solid or another robot stops instead, and the step counts
        as a collision or as a contact.
        """
        before = self.robot.split_state(state.robot)
        controls = self.robot.split_control(control)
        records, truths = self._move(state, before, controls, moment, info)
        moved = [each.state for each in records]
        clearance = jnp.stack([each.clearance for each in records])
        contact, team = jnp.zeros(self.num_robots, bool), state.team
        sent, links = jnp.zeros(()), jnp.zeros((), jnp.int32)
        coverages = state.members[0].progress.coverage[None]
        if team is not None:
            apart = stop_touching(self.robot, self.radii, before, moved)
            moved, contact = list(apart.states), apart.is_contact
            clearance = jnp.minimum(clearance, apart.gap)
            sent, links, coverages = team.sent, team.links, team.coverages
        records = [each._replace(state=robot) for each, robot in zip(records, moved, strict=True)]
        here, driven = state.robot, jnp.concatenate(moved)
        state, records = self._follow(state, records, truths, controls, moment)
        joint = jnp.concatenate([each.state for each in records])
        state = state._replace(robot=joint)
        if team is not None:
            known = self.measure_state(state)
            if self.disturbances.is_varying:
                # Robots that measure with noise know no more of the step than their models do.
                known = self._model.step(known_states(moment), control, self.control_period)
            team = self._talk.update_plans(team, here, driven, known, moment.step, info)
            state = state._replace(team=team)
        is_over = self.is_finished(state) | (state.finished > 0)
        together = {each.name: each.record(state.judged[each.name]) for each in self._judging}
        together[TEAM] = TeamRecord(coverages, contact, sent, links)
        record = stack_records(records, together)._replace(
            state=joint,
            control=control,
            coverage=state.coverage,
            clearance=clearance,
            effective_sample_size=info.effective_sample_size,
            is_finite=info.is_finite,
            is_faulty=moment.is_faulty,
            stop=moment.stop,
        )
        return state._replace(finished=state.finished + is_over.astype(jnp.int32)), record

    def _move(
        self,
        state: FleetState,
        before: Sequence[Array],
        controls: Sequence[Array],
        moment: Moment,
        info: Info,
    ) -> tuple[list[ExplorationRecord], list[dict[str, Any]]]:
        """Return the record of each robot among what is solid, and the states of its truths.

        Every process moves all robots. Of one that another process computes, nothing but the
        record's state, clearance and collision is meant.
        """
        here = dict(zip(self.share.mine, state.members, strict=True))
        given = zip(self.members, self.robot.robots, before, controls, strict=True)
        found = [
            # What is read of another state than the robot's is the same for equal robots.
            one.move(
                true_robot,
                here.get(index, state.members[0])._replace(robot=robot),
                control,
                moment._replace(guard=None),
                info,
            )
            for index, (one, true_robot, robot, control) in enumerate(given)
        ]
        return [record for record, _ in found], [truths for _, truths in found]

    def _follow(
        self,
        state: FleetState,
        records: Sequence[ExplorationRecord],
        truths: Sequence[dict[str, Any]],
        controls: Sequence[Array],
        moment: Moment,
    ) -> tuple[FleetState, list[ExplorationRecord]]:
        """Return the state with what the robots of this process know after the step of their
        records, and the records of all."""
        rooms: list[Flag | None] = [None] * self.num_robots
        landings = [each.landing for each in state.members]
        if self.num_robots > 1 and any(each is not None for each in landings):
            places = self._model.positions(jnp.concatenate([each.state for each in records]))
            rooms = list(find_room(landings, places, self.radii))
        members, followed = [], list(records)
        own = self.share.select(list(zip(self.members, truths, controls, rooms, strict=True)))
        for index, each, (one, after, control, room) in zip(
            self.share.mine, state.members, own, strict=True
        ):
            given = records[index], after, control, moment, room
            member, followed[index] = one.follow(each, *given)
            members.append(member)
        return state._replace(members=tuple(members)), followed

    def is_unfinished(self, state: FleetState) -> Flag:
        """Check whether the exploration is neither finished nor given up."""
        hover = self.members[0].hover_steps
        is_over = (state.finished > hover) | self.is_given_up(state)
        if self.members[0].goal is None:
            is_over = is_over | (self.is_finished(state) & (hover == 0))
        return ~is_over

    def is_finished(self, state: FleetState) -> Flag:
        """Check whether the robots together know the target coverage, or truths of parts say that
        the task is finished, and one of them is at the goal if there is one."""
        first = self.members[0]
        told = first.is_finished_by_parts(state.judged)
        is_covered = state.coverage >= first.target_coverage if told is None else told
        if first.goal is None:
            return is_covered
        if state.team is None:
            return first.is_finished(state.members[0])
        arrived = []
        for one, each in zip(self.members, state.members, strict=True):
            is_there, is_done = one.is_at_goal(each), is_covered
            assert is_there is not None
            if told is None:
                is_done = is_done | each.belief.is_explored
            arrived.append(is_there & is_done)
        return jnp.stack(arrived).any()

    def is_given_up(self, state: FleetState) -> Flag:
        """Check whether the coverage has not risen for long, see `ExplorationScenario`."""
        return self.members[0].is_given_up(state)

    def progress(self, state: FleetState) -> tuple[float, str]:
        """Return a share of 0, because the time left is unknown, and the coverage in words."""
        return self.members[0].progress(state)

    def for_batches(self) -> "Fleet":
        """Return the scenario with perceptions that are efficient under `jax.vmap`."""
        batched = self.explorations.map(lambda each: each.for_batches())
        same: Fleet = eqx.tree_at(lambda at: at.explorations, self, batched)
        return same

    def with_disturbances(self, disturbances: Sequence[Disturbance]) -> "Fleet":
        """Return the scenario with disturbances of each robot, by draws of its own.

        Args:
            disturbances: one of a name; measurements pass through them in this order.

        Raises:
            ValueError: what cannot happen to a robot, or to several.
        """
        check_disturbances(disturbances, self.num_robots)
        disturbed = self.explorations.map(lambda each: each.with_disturbances(disturbances))
        return with_field(self, "explorations", disturbed)

    def with_guard(self, guard: MotionGuard | None) -> "Fleet":
        """Return the scenario with a guard for each robot.

        Args:
            guard: the guard of each robot; None for none.
        """
        guarded = self.explorations.map(lambda each: each.with_guard(guard))
        return with_field(self, "explorations", guarded)

    def frame(
        self, state: FleetState, moment: Moment, inspect: Inspect | None, key: Key
    ) -> dict[str, Any]:
        """Return what the robots know together, their poses, plans and links."""
        plan = None if inspect is None else inspect(moment.observed, self._belief(state))
        links = None if state.team is None else self._talk.links(state, moment)
        return fleet_frame(self.members[0], self.robot, state, moment, self.share, plan, links)

    def make_frame(self, step: int, arrays: Any) -> Frame:
        """Make a frame on the host, with the cells that are on the map."""
        return super().make_frame(step, self.members[0].crop_frame(arrays))

    def recording(
        self,
        controller: Controller | None,
        before: FleetState,
        run: ChunkedRun[Any, ExplorationRecord, ExplorationFrame],
    ) -> ExplorationRecording:
        """Make the recording of a run."""
        local = make_fleet_recording(
            *(self.members[0], self.share, self.robot, self.start, before, run, self.coordination),
            is_given_up=bool(self.is_given_up(run.state.task)),
        )
        return local.move(self.datum.offset)

    @property
    def _talk(self) -> Talk:
        """How the robots tell one another what they know."""
        return Talk(
            self._model,
            self.explorations,
            self.share,
            self.identity,
            self.radii,
            self.radio,
            self.steps_per_exchange,
            self.plan_step,
            self.plan_length,
            self.coordination,
            self.is_start_known,
        )

    def _belief(self, state: FleetState) -> FleetBelief:
        return FleetBelief(tuple(each.belief for each in state.members), self.identity)
