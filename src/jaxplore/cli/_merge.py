"""`jaxplore merge`: one ROS map of several, whose frames nobody knows."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxplore._files import replace_files
from jaxplore._text import printable_path
from jaxplore.cli._terminal import say
from jaxplore.localisation.map_matching import MapMatch, match_maps
from jaxplore.maps.datum import Datum
from jaxplore.maps.files.ros import MapRules, map_datum, map_files
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.union import unite_maps
from jaxplore.report.drawing.figure import figure_bytes
from jaxplore.report.merged_maps import merged_figure


class _Given(NamedTuple):
    """A map of a file, relative to its datum."""

    path: Path
    grid: OccupancyGrid
    datum: Datum


class MergeOptions(NamedTuple):
    """Options of the command.

    `rules` and `unknown` say how images are read, see `read_map`. `picture` is a PNG file to draw.
    """

    picture: Path | None
    rules: MapRules
    unknown: int | None
    overwrite: bool


def merge_map_files(files: Sequence[Path], out: Path, options: MergeOptions) -> None:
    """Find the relative poses of maps, print them and write one map; refuse if one is uncertain.

    The result is in the frame of the first map. Of the others the one that fits best is merged
    first, and the rest is then looked for on the merged map.
    """
    if len(files) < 2:
        raise ValueError(f"{len(files)} maps are given; accepted: two or more")
    targets = [out, out.with_suffix(".pgm"), *([options.picture] if options.picture else [])]
    for target in targets:
        if target.exists() and not options.overwrite:
            raise ValueError(
                f"{printable_path(target)} exists; accepted: another --out, or --overwrite"
            )
    for file in files:
        if any(target.resolve() == file.resolve() for target in targets):
            raise ValueError(
                f"{printable_path(file)} is merged and written; accepted: another --out"
            )
    given = []
    for file in files:
        datum = map_datum(file)
        grid = OccupancyGrid.from_ros(
            file, datum=datum, rules=options.rules, unknown=options.unknown
        )
        given.append(_Given(file, grid, datum))
    first, *rest = given
    merged, parts = first.grid, [(first.path.stem, first.grid, np.zeros(3))]
    while rest:
        matches = [match_maps(merged, each.grid) for each in rest]
        certain = [index for index, match in enumerate(matches) if match.is_certain]
        if not certain:
            raise ValueError(_refusal(first, rest, matches))
        index = max(certain, key=lambda index: matches[index].score)
        each, match = rest.pop(index), matches[index]
        _tell(first, each, match)
        merged = unite_maps(merged, each.grid, match.pose)
        parts.append((each.path.stem, each.grid, match.pose))
    written = map_files(
        out,
        merged.crop(merged.probability),
        merged.resolution,
        first.datum.to_map(np.asarray(merged.frame.origin, np.float64)).tolist(),
    )
    if options.picture is not None:
        figure = merged_figure(merged, parts, first.datum)
        written.append((options.picture, figure_bytes(figure, "png")))
    replace_files(written)
    for target, _ in written:
        say(str(target))


def _tell(first: _Given, each: _Given, match: MapMatch) -> None:
    x, y, yaw = _pose_in_files(first, each, match)
    stds = np.sqrt(np.diag(match.covariance))
    say(
        f"{printable_path(each.path)} in the frame of {printable_path(first.path)}: "
        f"x {x:.3f} m, y {y:.3f} m, yaw {yaw:.4f} rad "
        f"(standard deviations {stds[0]:.3f}, {stds[1]:.3f}, {stds[2]:.4f})"
    )
    say(
        f"  certain: {match.agreeing:.1f} m of wall agree and {match.contradicted:.1f} m are "
        f"contradicted, {match.score:.1f} m here against {match.rival:.1f} m at the next best "
        f"pose; both know {match.overlap:.0f} m2"
    )


def _pose_in_files(first: _Given, each: _Given, match: MapMatch) -> tuple[float, float, float]:
    """Return the pose of a map's frame in that of the first one, in the coordinates of the files.

    `match` is relative to the datums of both.
    """
    x, y, yaw = match.pose.tolist()
    cos, sin = math.cos(yaw), math.sin(yaw)
    own, there = each.datum, first.datum
    return (
        x + there.x - (cos * own.x - sin * own.y),
        y + there.y - (sin * own.x + cos * own.y),
        yaw,
    )


def _refusal(first: _Given, rest: Sequence[_Given], matches: Sequence[MapMatch]) -> str:
    """Return why maps are not merged, in one line: the reason of the one that fits best."""
    index = max(range(len(rest)), key=lambda index: matches[index].score)
    others = f", and {len(rest) - 1} more" if len(rest) > 1 else ""
    return (
        f"where {printable_path(rest[index].path)}{others} lies on {printable_path(first.path)} is "
        f"not certain: {matches[index].doubt}; accepted: maps that overlap more, nothing is written"
    )
