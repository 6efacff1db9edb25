"""`jaxplore map-log`: a map from a log of a real lidar."""

import dataclasses
import json
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from jaxplore import _checks
from jaxplore._limits import FINEST
from jaxplore._text import short_repr
from jaxplore.cli._show import free_name, reserve
from jaxplore.cli._terminal import say
from jaxplore.localisation.log_mapping import COARSEST, LogMap, map_log
from jaxplore.localisation.log_odometry import default_drift, wide_odometry
from jaxplore.localisation.odometry import Odometry
from jaxplore.maps.files.ros import write_map
from jaxplore.report.console import progress_bar
from jaxplore.report.drawing.figure import write_figure
from jaxplore.report.folder import MARK, run_folder
from jaxplore.report.log_map import log_figure, log_metrics
from jaxplore.sensing.laser_log import read_laser_log

MOST_SEED = 2**32 - 1
"""Greatest seed of a random key."""


class MapLogOptions(NamedTuple):
    """Options of the command.

    When absent, `resolution` [m] follows from the scans, and `field_of_view`, the angle between the
    outermost beams [rad], from their number. Readings beyond `max_range` [m] are not used.
    `drift_seed` is that of made-up drift, which replaces the odometry of the log; None for that
    odometry. `assignments` are NAME=VALUE of errors of the odometry.
    """

    resolution: float | None
    max_range: float
    field_of_view: float | None
    drift_seed: int | None
    assignments: Sequence[str]
    overwrite: bool


def map_a_log(file: Path, out: Path | None, options: MapLogOptions) -> None:
    """Map a log, write the folder, by default named after the log, and print the metrics."""
    seed, given = options.drift_seed, options.assignments
    if seed is not None:
        seed = _checks.whole_number("--drift-seed", seed, at_least=0, at_most=MOST_SEED)
    drift = None if seed is None else _odometry(default_drift(), given)
    # Without any that are given they are fitted.
    odometry = _odometry(wide_odometry(), given) if given and seed is None else None
    resolution = options.resolution
    if resolution is not None:
        resolution = _checks.number("--resolution", resolution, at_least=FINEST, at_most=COARSEST)
    log = read_laser_log(file, field_of_view=options.field_of_view)
    name = Path(file.name.removesuffix(".gz")).stem
    folder = free_name(Path("runs") / f"{name}-map") if out is None else out
    reserve(folder, overwrite=options.overwrite)
    number = len(log.times)
    with ExitStack() as stack:
        bars: list[Callable[[float, str], None]] = []

        def show(scans: int, loops: int) -> None:
            # The first call comes after all checks, whose messages are one line without a bar.
            if not bars:
                bars.append(stack.enter_context(progress_bar("mapping", enabled=True)))
                bars[0](0.0, "compiling, about 10 s the first time")
                return
            bars[0](scans / number, f"{scans} of {number} scans, {loops} loops closed")

        mapped = map_log(
            log,
            odometry=odometry,
            drift=drift,
            key=None if seed is None else jax.random.key(seed),
            resolution=resolution,
            max_range=options.max_range,
            on_progress=show,
        )
    metrics = log_metrics(mapped)
    _write(mapped, metrics, folder, overwrite=options.overwrite)
    say(f"{number} scans over {metrics['path_length']:.1f} m, {mapped.num_loops} loops closed")
    if mapped.true is None:
        say(
            "The log has no other poses than its odometry, so the map is compared with nothing; "
            "--drift-seed puts drift on them"
        )
    else:
        before, after = metrics["dead_reckoned"], metrics["estimated"]
        say(f"ATE {after['ate']:.3f} m, by dead reckoning {before['ate']:.3f} m")
        say(f"walls: IoU {metrics['iou']:.3f}, {100 * metrics['double_walls']:.1f} % drawn twice")
    trust = mapped.trust
    say(
        f"{trust.num_places} places were seen twice, {100 * trust.doubtful_places:.0f} % of them "
        "look different"
    )
    for line in (log.news, trust.warning and f"Warning: {trust.warning}"):
        if line:
            say(line, err=True)
    for name in ("map.yaml", "map.png", MARK):
        say(str(folder / name))


def _write(mapped: LogMap, metrics: dict[str, object], folder: Path, *, overwrite: bool) -> None:
    grid = mapped.map
    origin = np.asarray(grid.frame.origin, np.float64) + np.append(mapped.start, 0.0)
    with run_folder(folder, overwrite=overwrite) as hidden:
        probability = grid.crop(grid.probability)
        write_map(hidden / "map.yaml", probability, grid.resolution, origin.tolist())
        write_figure(log_figure(mapped), hidden, "map", ["png"])
        trajectories = {
            name: getattr(mapped, name)
            for name in ("true", "dead_reckoned", "estimated")
            if getattr(mapped, name) is not None
        }
        np.savez_compressed(
            hidden / "trajectories.npz", times=mapped.times, start=mapped.start, **trajectories
        )
        (hidden / MARK).write_text(json.dumps(metrics, indent=2) + "\n")


def _odometry(usual: Odometry, assignments: Sequence[str]) -> Odometry:
    """Return an odometry with the standard deviations that `--set` names in place of its own."""
    values = {field.name: getattr(usual, field.name) for field in dataclasses.fields(usual)}
    for assignment in assignments:
        name, _, text = assignment.partition("=")
        if name not in values:
            raise ValueError(f"--set is {short_repr(assignment)}; accepted: {', '.join(values)}")
        try:
            values[name] = float(text)
        except ValueError:
            raise ValueError(
                f"--set {name} is {short_repr(text)}; accepted: a standard deviation >= 0"
            ) from None
    return Odometry(**values)
