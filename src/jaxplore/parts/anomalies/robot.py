"""Find what differs from the known map: a sequential test of each cell, and a second look."""

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_LOOKS
from jaxplore._types import ArrayLike, Flag, GridMask, GridValues, Pose, Rows, Scalar
from jaxplore._xla import on_device
from jaxplore.belief.obstacles import Obstacles
from jaxplore.belief.part import Observation, Part
from jaxplore.belief.sight import is_in_sight
from jaxplore.information.field import InformationField
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OCCUPIED_THRESHOLD, OccupancyGrid
from jaxplore.parts.anomalies.reports import (
    APPEARED,
    GONE,
    PERSON,
    SIGHT,
    Channel,
    Reports,
    cell_centres,
    square_distance,
)
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Scan
from jaxplore.sensing.change_evidence import BeamModel, beam_evidence
from jaxplore.sensing.fan import fan
from jaxplore.sensing.lidar import Lidar

LEAST_NOISE = 0.01
"""Least standard deviation of a range in the test [m]: without noise densities are infinite."""


MATE_REACH = 0.4
"""Distance from the outline of another robot of the fleet within which a beam ends at it [m]: it
moves between its word and the scan."""


class Anomalies(eqx.Module):
    """State of the search for anomalies.

    Args:
        known: (H, W) probability of the map that counts as known.
        forbidden: (H, W) cells in which nobody may be; None if there are none.
        change: (H, W) evidence of a change in each cell [nat].
        person: (H, W) evidence of somebody in each forbidden cell [nat]; None without such cells.
        is_settled: (H, W) cells near a report, which are no longer in the test.
        threshold: evidence at which a cell raises an alarm [nat].
        reports: suspicions and reports.
        num_cleared: number of suspicions that a second look has not confirmed.
        time: time of the last scan since the start [s].
    """

    known: GridValues
    forbidden: GridMask | None
    change: GridValues
    person: GridValues | None
    is_settled: GridMask
    threshold: Scalar
    reports: Reports
    num_cleared: Array
    time: Scalar

    @property
    def has_alarm(self) -> Flag:
        """Whether the evidence of any cell has reached the threshold."""
        found = (self.change >= self.threshold).any()
        if self.person is None:
            return found
        return found | (self.person >= self.threshold).any()


class AnomalyTest(Part):
    """Test of each scan for what differs from the known map, and the rules of the second look.

    A free cell in which beams end has something new in it. A wall that beams pass is gone. A beam
    that a moving obstacle ended in a forbidden cell shows a person. For each cell c, with z the
    range of a beam, the evidence is a cumulative sum of log-likelihood ratios:

        W_c <- max(0, W_c + sum over beams of ln [ p(z | c differs) / p(z | as known) ])

    `sensing.change_evidence` has the densities. As long as the world is as known, the likelihood
    ratio of any stretch of scans has a mean of at most 1. Therefore, by Ville's inequality, `W_c >=
    h` has at most the probability `exp(-h)` at any scan. With N cells in the test, the threshold

        h = ln(N / false_alarms)

    keeps the probability that a scan has any cell above it at or below `false_alarms`. It holds if
    `range_noise` includes the errors of the robot's pose and of the map.

    The first alarm is a *suspicion*. The robot goes for a second look, `attention` being the share
    by which information elsewhere counts less. The evidence around the place starts anew and grows
    only in scans from at most `near` away, and at least `baseline` from where the suspicion arose.
    If it crosses the threshold again, at least `stay` after the suspicion, the anomaly is
    *reported*. After `looks` such scans or `expiry`, the suspicion is dropped.

    Somebody who walks and is not tracked fills cells for a second, and others near them in the
    next. Therefore a suspicion is also dropped when its own cell is as known again, by the same
    test turned round (`Reports.add_absence`). A person who was where nobody may be may walk on.

    Sources: Wald, "Sequential tests of statistical hypotheses", Annals of Mathematical Statistics
    1945; Page, "Continuous inspection schemes", Biometrika 1954; Ville, "Etude critique de la
    notion de collectif", 1939.

    Args:
        false_alarms: greatest probability of a false suspicion in a scan, in (0, 1).
        outliers: probability that a range says nothing, in (0, 1).
        near: greatest distance of the second look [m].
        baseline: least distance between the first and the second look [m].
        looks: number of scans of a second look.
        stay: least time between a suspicion and its report, but of a person [s]: what stands there
            for less may have been somebody who passed.
        expiry: time after which a suspicion without a second look is dropped [s].
        attention: share of the information elsewhere that an open suspicion takes, in [0, 1).
        radius: distance within which alarms of a sort belong to one anomaly [m].
        range_noise: standard deviation of a range, errors of pose and map included [m]; that of the
            sensor when absent.
        forbidden: rectangles (x_min, y_min, x_max, y_max) in which nobody may be [m].

    Raises:
        ValueError: a value out of its range.
    """

    name: ClassVar[str] = "anomalies"
    needs: ClassVar[tuple[str, ...]] = ("watch",)

    false_alarms: Scalar
    outliers: Scalar
    near: Scalar
    baseline: Scalar
    looks: Array
    stay: Scalar
    expiry: Scalar
    attention: Scalar
    radius: Scalar
    range_noise: Scalar | None
    forbidden: Float[Array, "F 4"]

    def __init__(
        self,
        *,
        false_alarms: ArrayLike = 1e-4,
        outliers: ArrayLike = 0.01,
        near: ArrayLike = 5.0,
        baseline: ArrayLike = 1.0,
        looks: int = 20,
        stay: ArrayLike = 2.0,
        expiry: ArrayLike = 60.0,
        attention: ArrayLike = 0.9,
        radius: ArrayLike = 1.5,
        range_noise: ArrayLike | None = None,
        forbidden: Rows = (),
    ) -> None:
        self.false_alarms = _checks.scalar("false_alarms", false_alarms, above=0.0, below=1.0)
        self.outliers = _checks.scalar("outliers", outliers, above=0.0, below=1.0)
        self.near = _checks.scalar("near", near, above=0.0)
        self.baseline = _checks.scalar("baseline", baseline, at_least=0.0)
        self.looks = on_device(
            np.asarray(_checks.positive_int("looks", looks, at_most=MOST_LOOKS), np.int32)
        )
        self.stay = _checks.scalar("stay", stay, at_least=0.0)
        self.expiry = _checks.scalar("expiry", expiry, above=0.0)
        self.attention = _checks.scalar("attention", attention, at_least=0.0, below=1.0)
        self.radius = _checks.scalar("radius", radius, above=0.0)
        self.range_noise = (
            None if range_noise is None else _checks.scalar("range_noise", range_noise, above=0.0)
        )
        accepted = "(F, 4), finite numbers (x_min, y_min, x_max, y_max)"
        rows = _checks.floats("forbidden", forbidden, accepted)
        if rows.size == 0:
            rows = np.zeros((0, 4), np.float32)
        is_bad = ~np.isfinite(rows)
        if is_bad.any():
            raise ValueError(f"forbidden has a value {rows[is_bad][0]}; accepted: {accepted}")
        if rows.ndim != 2 or rows.shape[1] != 4:
            raise ValueError(f"forbidden has shape {rows.shape}; accepted: {accepted}")
        self.forbidden = on_device(rows.copy())

    def check(self, sensors: Sequence[Sensor], ground: Ground | None) -> None:
        """Check that the ground is level and the first sensor a lidar."""
        if ground is not None:
            raise ValueError("ground is given; accepted with a test for anomalies: level ground")
        if not isinstance(sensors[0], Lidar):
            kind = type(sensors[0]).__name__
            raise ValueError(
                f"sensors begin with a {kind}; accepted with a test for anomalies: Lidar"
            )

    @_kinds.check_arguments
    def init(self, grid: OccupancyGrid) -> Anomalies:
        """Return the state before the first scan.

        Args:
            grid: the map that counts as known. Unknown cells are not in the test.
        """
        height, width = grid.sides
        cells = jnp.asarray(height * width, jnp.float32)
        nothing = jnp.zeros(grid.shape)
        forbidden = self._find_forbidden(grid) if self.forbidden.shape[0] else None
        tests = cells if forbidden is None else cells + jnp.sum(forbidden, dtype=jnp.float32)
        return Anomalies(
            known=grid.probability,
            forbidden=forbidden,
            change=nothing,
            person=None if forbidden is None else nothing,
            is_settled=jnp.zeros(grid.shape, bool),
            threshold=jnp.log(tests) - jnp.log(self.false_alarms),
            reports=Reports.none(),
            num_cleared=jnp.zeros((), jnp.int32),
            time=jnp.zeros(()),
        )

    def observe(self, own: Anomalies, observation: Observation) -> Anomalies:
        """Return the state after a scan."""
        state, (sensor, grid, scan, is_seen, pose, elapsed, time, others) = own, observation
        time = state.time + elapsed if time is None else time
        is_mate = find_mate_beams(others, sensor, scan, pose)
        change, person = self.evidence(state, sensor, grid, scan, pose, is_mate)
        gathered = self.add_evidence(state, change, person)
        # Most scans raise no alarm, and nothing waits for a second look.
        is_quiet = ~state.reports.is_open.any() & ~gathered.has_alarm
        after: Anomalies = jax.lax.cond(
            is_quiet,
            lambda _, same: same,
            lambda before, same: self._update_reports(
                before, same, change, grid, is_seen, pose, time
            ),
            state,
            gathered,
        )
        return dataclasses.replace(after, time=time)

    def add_evidence(
        self, state: Anomalies, change: GridValues, person: GridValues | None
    ) -> Anomalies:
        """Return the state with the `evidence` of a scan, and the same reports."""

        def accumulate(before: GridValues, more: GridValues) -> GridValues:
            grown = jnp.clip(before + more, 0.0, 2.0 * state.threshold)
            return jnp.where(state.is_settled, 0.0, grown)

        people = state.person
        if people is not None and person is not None:
            people = accumulate(people, person)
        return dataclasses.replace(state, change=accumulate(state.change, change), person=people)

    def _update_reports(
        self,
        before: Anomalies,
        state: Anomalies,
        change: GridValues,
        grid: OccupancyGrid,
        is_seen: GridMask,
        pose: Pose,
        time: Scalar,
    ) -> Anomalies:
        """Return the state with the suspicions and reports that follow from its evidence.

        `state` has the evidence of the scan, and `before` is the state before it. `change` is the
        evidence of the scan alone, and `is_seen` are the cells that it observed. `grid` has the
        frame of the map.
        """
        centres, reports = cell_centres(grid), state.reports.add_absence(grid, change)
        away = reports.away(centres)
        around = away <= self.radius**2
        # The second look counts from near and from another place than the first.
        to_place = jnp.linalg.norm(reports.place - pose[:2], axis=-1)
        moved = jnp.linalg.norm(reports.seen_from - pose[:2], axis=-1)
        is_still = (time - reports.suspected >= self.stay) | (reports.kind == PERSON)
        is_near = (to_place <= self.near) & (moved >= self.baseline)
        is_looking = reports.is_open & is_near & is_still
        waiting = reports.is_open & ~is_looking
        kinds = jnp.where(state.known >= 0.5, jnp.int32(GONE), jnp.int32(APPEARED))
        things = Channel(state.change, kinds, False)
        channels = [things.wait(before.change, waiting, reports.kind, around)]
        if before.person is not None and state.person is not None:
            somebody = jnp.full(grid.shape, PERSON, jnp.int32)
            people = Channel(state.person, somebody, True)
            channels.append(people.wait(before.person, waiting, reports.kind, around))
        near = ((away <= SIGHT**2) & is_seen).any(axis=(1, 2))
        crossed = jnp.zeros_like(is_looking)
        for channel in channels:
            alarms = around & (channel.evidence >= state.threshold)
            crossed |= alarms.any(axis=(1, 2)) & channel.owns(reports.kind)
        # What has left its place was somebody who passed, and what is near there now is another.
        has_left = (reports.absent >= state.threshold) & (reports.kind != PERSON)
        is_confirmed = is_looking & crossed & ~has_left
        reports = reports.record_look(is_looking & near, is_confirmed, time)
        is_late = (reports.looks >= self.looks) | (time - reports.suspected >= self.expiry)
        is_dropped = reports.is_open & (is_late | has_left)
        kinds_before = reports.kind
        reports = reports.drop(is_dropped)
        is_settled = state.is_settled | (around & is_confirmed[:, None, None]).any(axis=0)
        sums = []
        for channel in channels:
            # A suspicion of the other sort does not keep a person from being found, nor a thing.
            own = channel.owns(kinds_before)
            restart = is_settled | (around & (is_dropped & own)[:, None, None]).any(axis=0)
            is_closed = restart | (around & (reports.is_open & own)[:, None, None]).any(axis=0)
            is_new, place, spot, kind = channel.peak(
                state.threshold, is_closed, centres, self.radius
            )
            opened = reports.open_suspicion(is_new, place, spot, kind, time, pose)
            is_put = (opened.kind != reports.kind).any()
            reports = opened
            restart |= is_put & (square_distance(centres, place) <= self.radius**2)
            sums.append(jnp.where(restart, 0.0, channel.evidence))
        return dataclasses.replace(
            state,
            change=sums[0],
            person=sums[1] if len(sums) > 1 else None,
            is_settled=is_settled,
            reports=reports,
            num_cleared=state.num_cleared + jnp.sum(is_dropped, dtype=jnp.int32),
        )

    def evidence(
        self,
        state: Anomalies,
        sensor: Sensor,
        grid: OccupancyGrid,
        scan: Scan,
        pose: Pose,
        is_left_out: Bool[Array, " B"] | None = None,
    ) -> tuple[GridValues, GridValues | None]:
        """Return the sums of log-likelihood ratios (H, W) of one scan, of changes and of persons.

        Args:
            state: state of the search.
            sensor: sensor of the scan.
            grid: a grid with the frame of the map.
            scan: the scan.
            pose: pose (x, y, yaw) of the robot [m, m, rad].
            is_left_out: (B,) beams that say nothing; none when absent.
        """
        # The beams are followed through the map of before, not through the one that shows the
        # change.
        known = grid.with_probability(state.known)
        turn = pose[2] - grid.frame.origin[2]
        angles = turn + jnp.asarray(sensor.beam_angles)
        cells = fan(known, pose[:2], angles, sensor.max_range)
        noise = sensor.range_noise if self.range_noise is None else self.range_noise
        model = BeamModel(jnp.maximum(noise, LEAST_NOISE), sensor.max_range, self.outliers)
        occupancy = known.at_cell(cells.cell)
        found = beam_evidence(
            model,
            cells,
            occupancy < FREE_THRESHOLD,
            occupancy > OCCUPIED_THRESHOLD,
            scan.ranges,
            scan.is_return,
            grid.resolution,
        )
        # Cells off the map, and beams that say nothing, get an index behind the last cell, which
        # the scatter drops: shapes stay fixed.
        height, width = grid.shape
        index = cells.cell[..., 0] * width + cells.cell[..., 1]
        is_counted = grid.contains(cells.cell)
        if is_left_out is not None:
            is_counted = is_counted & ~is_left_out[:, None]
        index = jnp.where(is_counted, index, height * width).reshape(-1)

        def collect(ratios: Float[Array, "B N"]) -> GridValues:
            total = jnp.zeros(height * width).at[index].add(ratios.reshape(-1), mode="drop")
            return total.reshape(height, width)

        if state.forbidden is None:
            return collect(found.change), None
        person = jnp.where(state.forbidden, collect(found.person), 0.0)
        return collect(found.change), person

    def add_information(
        self, own: Anomalies, field: InformationField, grid: OccupancyGrid, sensor: Sensor
    ) -> InformationField:
        """Return an information field that leads to the place of the oldest open suspicion.

        That is one which has lasted for `stay`, or of a person. Nodes from which a second look is
        possible get the greatest information of the field.
        Elsewhere it is less by the share `attention`. A field without such nodes stays as it is.
        """
        reports = own.reports
        has_stayed = (own.time - reports.suspected >= self.stay) | (reports.kind == PERSON)
        is_wanted = reports.is_open & has_stayed
        oldest = jnp.argmin(jnp.where(is_wanted, reports.suspected, jnp.inf))
        place, seen_from = reports.place[oldest], reports.seen_from[oldest]
        height, width = field.total.shape
        rows, columns = jnp.mgrid[:height, :width]
        nodes = field.frame.cell_centre(jnp.stack([rows, columns], axis=-1))
        distance = jnp.linalg.norm(nodes - place, axis=-1)
        is_apart = jnp.linalg.norm(nodes - seen_from, axis=-1) > self.baseline
        is_shown = is_in_sight(grid, nodes, place, 2.0 * SIGHT)
        views = is_shown & is_apart & (distance <= 0.9 * self.near) & is_wanted[oldest]
        is_attended = views.any()
        kept = jnp.where(is_attended, 1.0 - self.attention, 1.0)
        bonus = jnp.where(views, jnp.max(field.total), 0.0)
        sectors = field.sectors.shape[0]
        turns = (jnp.arange(sectors + 1) / sectors)[:, None, None]
        result: InformationField = eqx.tree_at(
            lambda each: (each.sectors, each.cumulative),
            field,
            (kept * field.sectors + bonus / sectors, kept * field.cumulative + turns * bonus),
        )
        return result

    def merge(self, own: Anomalies, told: Anomalies, is_heard: Bool[Array, " N"]) -> Anomalies:
        """Return the state with the reports of other robots; suspicions are each robot's own."""
        is_report = is_heard[:, None] & jnp.isfinite(told.reports.reported)
        rows = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), told.reports)

        def add(row: Array, reports: Reports) -> Reports:
            one: Reports = jax.tree.map(lambda leaf: leaf[row], rows)
            is_new = is_report.reshape(-1)[row]
            return reports.add_report(one, is_new, self.radius)

        reports = jax.lax.fori_loop(0, is_report.size, add, own.reports)
        settled = own.is_settled | (is_heard[:, None, None] & told.is_settled).any(axis=0)
        person = None if own.person is None else jnp.where(settled, 0.0, own.person)
        return dataclasses.replace(
            own,
            reports=reports,
            is_settled=settled,
            change=jnp.where(settled, 0.0, own.change),
            person=person,
        )

    def _find_forbidden(self, grid: OccupancyGrid) -> GridMask:
        centres = cell_centres(grid)[..., None, :]
        low, high = self.forbidden[:, :2], self.forbidden[:, 2:]
        is_in = ((centres >= low) & (centres <= high)).all(axis=-1).any(axis=-1)
        return is_in & (grid.probability < FREE_THRESHOLD)


def find_mate_beams(
    others: Obstacles | None, sensor: Sensor, scan: Scan, pose: Pose
) -> Bool[Array, " B"] | None:
    """Return which beams of a scan from a pose [m, m, rad] end at robots of the fleet.

    These have told where they drive, as nobody else does. None if nobody tells.
    """
    if others is None or others.plans is None or others.outlines.number == 0:
        return None
    angles = pose[2] + jnp.asarray(sensor.beam_angles)
    ahead = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1)
    ends = pose[:2] + scan.ranges[:, None] * ahead
    is_mate = others.plans.is_fresh
    away = jax.vmap(others.outlines.distances)(ends)
    return ((away <= MATE_REACH) & is_mate).any(axis=-1)
