"""Compute the metrics of an exploration run from its recording."""

import numpy as np

from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OCCUPIED_THRESHOLD
from jaxplore.report._numbers import finite, finite_mean
from jaxplore.report.coverage_levels import at_instants, reach_levels
from jaxplore.report.exploration.data import ExplorationData
from jaxplore.report.exploration.guard import guard_metrics
from jaxplore.report.exploration.localisation import localisation_metrics
from jaxplore.report.exploration.metrics import ExplorationMetrics
from jaxplore.report.exploration.progress import longest_stall, progress
from jaxplore.report.metrics import thin_series
from jaxplore.report.motion import command_jerk, episodes


def compute_metrics(recording: ExplorationData, *, seed: int | None = None) -> ExplorationMetrics:
    """Compute the metrics of a run, finished or not; without a step those of its start."""
    records, period = recording.records, recording.control_period
    time, coverage, entropy, path = progress(recording)
    in_contact = recording.by_robot(records.is_collision).astype(bool)
    sample_size = np.asarray(records.effective_sample_size, np.float64)
    sample_size = sample_size[np.isfinite(sample_size)]
    curve = {"time": time, "coverage": coverage, "path": path, **recording.part_curves()}
    final_entropy, final_unknown = measure_belief(recording)
    if entropy is not None and records.unknown is not None:
        unknown = at_instants(records.unknown, recording.initial_unknown)
        curve |= {"entropy": entropy, "unknown": unknown}
        final_entropy, final_unknown = entropy[-1], float(unknown[-1])
    lost = recording.initial_entropy - final_entropy
    parts, given_up = recording.part_metrics(), recording.given_up_step
    ends_by_parts = any(each.is_end for each in parts.values())
    finished_at = _find_finish(recording, float(coverage[-1]), ends_by_parts=ends_by_parts)
    diversity, replaced = fusion_means(recording)
    return ExplorationMetrics(
        **recording.common_metrics(finished_at=finished_at, seed=seed),
        given_up_at=None if given_up is None else given_up * period,
        coverage=float(coverage[-1]),
        target_coverage=recording.target_coverage,
        target=recording.target,
        walls_seen=_walls_seen(recording),
        **reach_levels(coverage, path, period),
        path_length=float(path[-1]),
        initial_entropy=finite(recording.initial_entropy),
        final_entropy=finite(final_entropy),
        initial_unknown=recording.initial_unknown,
        final_unknown=final_unknown,
        information_per_metre=finite(lost / path[-1]) if path[-1] > 0 else None,
        goal_distance=_goal_distance(recording),
        command_jerk=command_jerk(
            records.control, recording.control_half_range, recording.control_period
        ),
        fault_steps=int(np.asarray(records.is_faulty, bool).sum()),
        **guard_metrics(records.stop),
        collisions=sum(episodes(each) for each in in_contact.T),
        collision_steps=int(in_contact.sum()),
        minimum_clearance=finite(np.min(records.clearance, initial=np.inf)),
        mean_effective_sample_size=finite(sample_size.mean()) if sample_size.size else None,
        minimum_effective_sample_size=finite(np.min(sample_size, initial=np.inf)),
        non_finite_steps=int((~np.asarray(records.is_finite, bool)).sum()),
        untraversable_steps=int(np.asarray(records.is_untraversable, bool).sum()),
        parts=parts,
        members=member_means(recording),
        diversity=diversity,
        replaced=replaced,
        **localisation_metrics(recording),
        reachable_area=float(recording.reachable.sum()) * recording.resolution**2,
        longest_stall=period
        * max(longest_stall(each.positions, coverage) for each in recording.robots),
        coverage_curve=thin_series(curve, period),
    )


def measure_belief(recording: ExplorationData) -> tuple[float, float]:
    """Return the entropy of the reachable cells on the map at the end [nat], and the share of them
    that is unknown."""
    p = np.asarray(recording.belief, np.float64)[np.asarray(recording.reachable, bool)]
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = np.nan_to_num(p * np.log(p)) + np.nan_to_num((1.0 - p) * np.log1p(-p))
    is_unknown = 4.0 * p * (1.0 - p) > 0.5
    return -float(terms.sum()), float(is_unknown.mean()) if p.size else 0.0


def _find_finish(
    recording: ExplorationData, coverage: float, *, ends_by_parts: bool
) -> float | None:
    if recording.finished_step is not None:
        return recording.finished_step * recording.control_period
    target = recording.target_coverage
    is_judged = recording.target == "coverage" and target is not None
    if recording.goal is not None or ends_by_parts or not is_judged:
        return None
    # A run that begins at the target coverage takes no step.
    return 0.0 if coverage >= np.float32(target) and recording.num_steps == 0 else None


def _walls_seen(recording: ExplorationData) -> float | None:
    """Return the share of the wall cells beside the free space of the start that are on the map."""
    import scipy.ndimage  # slow to import, and few need it

    if recording.localisation is not None:
        return None  # its map is moved against the true one
    free = recording.world < FREE_THRESHOLD
    labels, _ = scipy.ndimage.label(free)
    room = np.isin(labels, np.unique(labels[recording.reachable & free]))
    walls = scipy.ndimage.binary_dilation(room) & (recording.world > OCCUPIED_THRESHOLD)
    number = int(walls.sum())
    return None if number == 0 else float((recording.belief > OCCUPIED_THRESHOLD)[walls].mean())


def _goal_distance(recording: ExplorationData) -> float | None:
    if recording.goal is None:
        return None
    return float(np.hypot(*(recording.last_positions - recording.goal).T).min())


def _first(mask: np.ndarray) -> int | None:
    return int(mask.argmax()) if mask.any() else None


def member_means(recording: ExplorationData) -> dict[str, dict[str, float | None]] | None:
    """Compute the mean share of each member in the control, and means over its own plans.

    `share`, `uncertainty` [half ranges], `effective_sample_size` and `cost`: means over the steps
    in which they were finite; None if they never were. None without members or without a step.
    """
    members = recording.records.members
    if members is None or recording.num_steps == 0:
        return None
    columns = {
        "share": members.shares,
        "uncertainty": members.uncertainties,
        "effective_sample_size": members.effective_sample_sizes,
        "cost": members.costs,
    }
    return {
        name: {key: finite_mean(rows[:, number]) for key, rows in columns.items()}
        for number, name in enumerate(recording.member_names)
    }


def fusion_means(recording: ExplorationData) -> tuple[float | None, float | None]:
    """Compute the mean diversity of the members' controls [half ranges], and the share of steps in
    which one member's plan replaced the mixture; None without members or a step."""
    members = recording.records.members
    if members is None or recording.num_steps == 0:
        return None, None
    return finite_mean(members.diversity), finite_mean(members.is_replaced)
