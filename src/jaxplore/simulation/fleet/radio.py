"""What the robots of a fleet tell one another: maps, ways and plans."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplore import _checks, _kinds
from jaxplore._equal_objects import Alike
from jaxplore._types import ArrayLike, Count, Flag, GridValues, Pose, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.belief.claims import claim_cost, trust_in
from jaxplore.belief.merging import log_odds_change, merge_maps
from jaxplore.control.fleet_share import Share
from jaxplore.simulation.exploration.progress import MapSums, map_progress
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.fleet.rows import by_identity

NEVER = -1
"""Version of what was never heard."""
CELL_BYTES, NODE_BYTES = 8, 4
"""Size of a message: index and log-odds of each cell that is new to the receiver, and the length of
the path to each node that can be reached [bytes]."""


class Heard(NamedTuple):
    """What each robot (first axis) has last heard of each robot (second axis), itself included.

    Args:
        log_odds: (N, N, H, W) changes of the log-odds by that robot's own scans.
        lengths: (N, N, rows, columns) lengths of that robot's paths to the nodes [m]; infinite if
            never heard.
        version: (N, N) step in which that robot made them; `NEVER` if never heard.
    """

    log_odds: Float[Array, "N N H W"]
    lengths: Float[Array, "N N rows columns"]
    version: Int[Array, "N N"]

    @classmethod
    def nothing(cls, number: int, cells: tuple[int, int], nodes: tuple[int, int]) -> "Heard":
        """Return what robots know of one another before the first exchange."""
        return cls(
            jnp.zeros((number, number, *cells)),
            jnp.full((number, number, *nodes), jnp.inf, jnp.float32),
            jnp.full((number, number), NEVER, jnp.int32),
        )


class Radio(eqx.Module):
    """Who hears whom, and what claims follow from it.

    All fields are array leaves: no change of a number recompiles.

    Args:
        radio_range: greatest distance of two robots that hear each other [m].
        uses_sight: whether two robots of which one sees the other hear each other at any distance.
        is_central: whether all robots hear each other at any distance, as over a base station.
        claim_sharpness: difference of the lengths of two robots' paths for a factor e between their
            shares of a place [m], see `jaxplore.belief.claims`.
        claim_memory: age at which a claim counts 1/e [s].

    Raises:
        ValueError: a range, a sharpness or a memory that is not a positive number.
    """

    radio_range: Scalar
    uses_sight: Flag
    is_central: Flag
    claim_sharpness: Scalar
    claim_memory: Scalar

    def __init__(
        self,
        radio_range: ArrayLike = 15.0,
        *,
        uses_sight: bool = True,
        is_central: bool = False,
        claim_sharpness: ArrayLike = 1.0,
        claim_memory: ArrayLike = 60.0,
    ) -> None:
        self.radio_range = _checks.scalar("radio_range", radio_range, above=0.0)
        self.uses_sight = jnp.asarray(_kinds.flag("uses_sight", uses_sight))
        self.is_central = jnp.asarray(_kinds.flag("is_central", is_central))
        self.claim_sharpness = _checks.scalar("claim_sharpness", claim_sharpness, above=0.0)
        self.claim_memory = _checks.scalar("claim_memory", claim_memory, above=0.0)

    def links(self, positions: Float[Array, "N 2"], sees: Bool[Array, "N N"]) -> Bool[Array, "N N"]:
        """Return which robots hear each other; none hears itself.

        Args:
            positions: (N, 2) true positions [m].
            sees: (N, N) whether each robot (first axis) sees each other one.
        """
        offset = positions[:, None] - positions[None, :]
        is_near = jnp.sqrt(jnp.sum(offset * offset, axis=-1)) <= self.radio_range
        linked = is_near | (self.uses_sight & (sees | sees.T)) | self.is_central
        return linked & ~jnp.eye(positions.shape[0], dtype=bool)


def newest(version: Int[Array, "N N"], links: Bool[Array, "N N"]) -> Int[Array, "N N"]:
    """Return from which robot (N, N) each robot takes what is known of each robot.

    It takes that from itself, or from the one that it hears and that knows a newer version.
    `version` (N, N) is what each robot (first axis) knows of each robot, and `links` (N, N) which
    robots hear each other.
    """
    number = version.shape[0]
    own = jnp.eye(number, dtype=bool)
    # (holder, from, of); twice the version leaves room to prefer what is known already.
    offers = jnp.where((links | own)[:, :, None], 2 * version[None], 2 * NEVER - 1)
    return jnp.argmax(offers + own[:, :, None].astype(jnp.int32), axis=1)


class Taken(NamedTuple):
    """What each robot (first axis) has of each robot (second axis), as the result of `take_values`.

    `is_news` (N, ...) says where any of it differs from what the robot had. `number` is how many
    values differ, of all robots.
    """

    values: Float[Array, "N N *A"]
    is_news: Bool[Array, "N *A"]
    number: Scalar


def take_values(
    values: Float[Array, "N N *A"], source: Int[Array, "N N"], version: Int[Array, "N N"]
) -> Taken:
    """Return `values[source[i, k], k]` for each robot i and each robot k that is known.

    Whole maps are copied and compared one by one, in place, and those that a robot has already are
    not: a gather of all of them at once would move them cell by cell. Robots take in the order of
    their versions, the oldest first. A robot takes from one with a newer version alone, so what it
    takes has not been replaced yet. `source` is the result of `newest` for these versions.
    """
    number, shape = source.shape[0], values.shape[2:]
    zeros = (0,) * len(shape)
    is_taken = source != jnp.arange(number)[:, None]
    barrier = jax.lax.optimization_barrier
    order = jnp.argsort(jnp.where(is_taken, version, np.iinfo(np.int32).max).reshape(-1))

    def take(rank: Count, so_far: Taken) -> Taken:
        holder, of = jnp.divmod(order[rank], number)
        there, here = (
            jax.lax.dynamic_slice(so_far.values, (robot, of, *zeros), (1, 1, *shape))
            for robot in (source[holder, of], holder)
        )
        # Otherwise XLA reads them while it writes, for which it copies all maps.
        there, here = barrier((there, here))  # type: ignore[no-untyped-call]
        is_new = there != here
        known = jax.lax.dynamic_slice(so_far.is_news, (holder, *zeros), (1, *shape))
        return Taken(
            jax.lax.dynamic_update_slice(so_far.values, there, (holder, of, *zeros)),
            jax.lax.dynamic_update_slice(so_far.is_news, known | is_new[0], (holder, *zeros)),
            so_far.number + jnp.sum(is_new, dtype=jnp.float32),
        )

    nothing = Taken(values, jnp.zeros((number, *shape), bool), jnp.zeros(()))
    found: Taken = jax.lax.fori_loop(0, jnp.sum(is_taken, dtype=jnp.int32), take, nothing)
    return found


class Exchanged(NamedTuple):
    """Result of an exchange; `sent` is the size of all messages [bytes].

    `merged` is the map (H, W) of each robot after it. The beliefs of `members` have these maps and
    the claims.
    """

    members: tuple[ExplorationState, ...]
    heard: Heard
    merged: tuple[Float[Array, "H W"], ...]
    sent: Scalar


def share_parts(
    scenarios: Sequence[ExplorationScenario],
    share: Share,
    members: Sequence[ExplorationState],
    links: Bool[Array, "N N"],
) -> tuple[list[ExplorationState], Scalar]:
    """Let each robot merge what the parts of those that it hears know; return the bytes as well.

    A message has the index and the value of each number that is new to the receiver. Scenarios and
    members are those of the M robots of `share`; `links` (N, N) says who hears whom.
    """
    parts, sent = scenarios[0].perception.parts, jnp.zeros(())
    if not parts:
        return list(members), sent
    rows = share.gather([each.belief.parts for each in members])
    told = jax.tree.map(lambda *each: jnp.stack(each), *rows)
    counts, after = [], []
    for i, one, each in zip(share.mine, scenarios, members, strict=True):
        own = each.belief.parts
        merged = {
            part.name: part.merge(own[part.name], told[part.name], links[i])
            for part in one.perception.parts
            if part.name in own
        }
        pairs = zip(jax.tree.leaves(merged), jax.tree.leaves(own), strict=True)
        counts.append(sum(jnp.sum(new != old, dtype=jnp.float32) for new, old in pairs))
        after.append(each.with_belief(each.belief.with_parts(merged)))
    for number in share.gather(counts):
        sent = sent + CELL_BYTES * number
    return after, sent


def exchange(
    radio: Radio,
    explorations: Alike[ExplorationScenario],
    share: Share,
    identity: Int[Array, " N"],
    members: Sequence[ExplorationState],
    heard: Heard,
    merged: Sequence[Float[Array, "H W"]],
    links: Bool[Array, "N N"],
    poses: Sequence[Pose],
    step: Count,
    time: Scalar,
    *,
    with_lengths: bool,
    with_claims: bool,
) -> Exchanged:
    """Let the robots that hear each other pass on all that they have heard, and merge their maps.

    News travel by one robot per exchange. Explorations, members, maps and poses are those of the M
    robots that this process computes, which are `share`. `merged` are their maps (H, W) after the
    last exchange, `poses` are observed [m, m, rad]. Sums over robots are in the order of `identity`
    (N,). `links` (N, N) says which robots hear each other. `step` steps were done before.
    `with_lengths` says whether the lengths of paths are told, `with_claims` whether claims follow
    from them; both are static.
    """
    number, scenarios = share.number, explorations.all
    every = jnp.arange(number)
    grids = [each.belief.grid.probability for each in members]
    changes = [
        log_odds_change(one.perception.sensor_model, old, now)
        for one, old, now in zip(scenarios, merged, grids, strict=True)
    ]
    own = jnp.stack(share.gather(changes))
    log_odds = heard.log_odds.at[every, every].add(own)
    version = heard.version.at[every, every].set(step)
    source = newest(version, links)
    received, is_news, cells = take_values(log_odds, source, version)
    sent = CELL_BYTES * cells
    # Beyond the clamp, what a robot adds to its map is not what it adds to the sum. So cells of its
    # own scans follow the sum as well, and robots that have heard the same agree.
    is_changed = is_news | (links.any(axis=1)[:, None, None] & (own != 0.0))

    def merge(
        one: ExplorationScenario, belief: Belief, pose: Pose, row: Count
    ) -> tuple[GridValues, GridValues, MapSums, Float[Array, "rows columns"] | None]:
        perception, reachable = one.perception, one.map_arrays.reachable
        prior, before = one.map_arrays.prior.probability, belief.grid.probability
        probability = merge_maps(
            perception.sensor_model,
            prior,
            by_identity(received[row], identity),
            before,
            is_changed[row],
        )
        belief = perception.with_map(belief, belief.grid.with_probability(probability))
        lengths = None
        if with_lengths:
            stride = perception.field_sensor.stride
            roads = perception.locomotion.roadmap(
                belief.clearance, perception.required_clearance, stride
            )
            lengths = roads.lengths_from(pose)
        return probability, belief.clearance.values, MapSums.of(probability, reachable), lengths

    # What a merge does not read stays where it is.
    closing = [part for part in scenarios[0].perception.parts if part.closes_cells]
    small = [
        Belief(
            grid=each.belief.grid,
            clearance=each.belief.clearance,
            parts={part.name: each.belief.parts[part.name] for part in closing},
        )
        for each in members
    ]
    found = explorations.each(merge, small, poses, [every[i] for i in share.mine])
    after = []
    for state, (probability, clearance, sums, _) in zip(members, found, strict=True):
        belief = dataclasses.replace(
            state.belief,
            grid=state.belief.grid.with_probability(probability),
            clearance=dataclasses.replace(state.belief.clearance, values=clearance),
        )
        if state.judged.track is not None:
            # Its coverage is that of its own scans at their true poses.
            sums = state.judged.sums
        progress = map_progress(sums, belief.grid)
        judged = state.judged._replace(sums=sums, progress=progress)
        after.append(state.with_belief(belief)._replace(judged=judged))
    after, told_bytes = share_parts(scenarios, share, after, links)
    sent = sent + told_bytes
    maps = tuple(probability for probability, *_ in found)
    told = heard.lengths
    if with_lengths:
        lengths = share.gather([each[-1] for each in found])
        told, *_ = take_values(told.at[every, every].set(jnp.stack(lengths)), source, version)
        is_told = (source != every[:, None])[:, :, None, None] & jnp.isfinite(told)
        sent = sent + NODE_BYTES * jnp.sum(is_told, dtype=jnp.float32)
    version = version[source, every[None, :]]
    if with_claims:
        age = (step - version).astype(jnp.float32) * scenarios[0].control_period
        age = jnp.where((version == NEVER) | jnp.eye(number, dtype=bool), jnp.inf, age)
        for at, (i, one) in enumerate(zip(share.mine, scenarios, strict=True)):
            cost = claim_cost(
                lengths[i],
                by_identity(told[i], identity),
                by_identity(trust_in(age[i], radio.claim_memory), identity),
                sharpness=radio.claim_sharpness,
                decay_length=one.perception.decay_length,
            )
            belief = dataclasses.replace(after[at].belief, claims=cost)
            after[at] = after[at].with_belief(belief)
    return Exchanged(tuple(after), Heard(received, told, version), maps, sent)
