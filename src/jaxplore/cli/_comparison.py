"""`jaxplore compare`: calls `jaxplore.compare` and `compare_maps`, and prints their tables."""

import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxplore._exit import FAILED, INTERRUPTED
from jaxplore._limits import MOST_AT_ONCE, MOST_SEEDS
from jaxplore.cli._entries import SAMPLES, option_entries, with_samples
from jaxplore.cli._memory import check_count, check_memory, memory_limit
from jaxplore.cli._pictures import Pictures, take_pictures
from jaxplore.cli._runner import RUNNER, make_runner
from jaxplore.cli._show import free_name, reserve, show_comparison, show_starts
from jaxplore.cli._terminal import say
from jaxplore.report.console import progress_bar
from jaxplore.report.drawing.film import FilmOptions
from jaxplore.report.table import print_table
from jaxplore.settings.architectures import GROUND, QUADROTOR
from jaxplore.settings.readers import read_values
from jaxplore.settings.sections import RunSettings
from jaxplore.study.comparison.compare import compare
from jaxplore.study.comparison.compare_maps import MapComparison, compare_maps
from jaxplore.study.comparison.episodes import variant_entries
from jaxplore.study.comparison.maps import maps_in, with_starts
from jaxplore.study.comparison.store import Plan
from jaxplore.study.runner import Runner
from jaxplore.study.seeds import check_number_of_seeds
from jaxplore.study.variants import make_variants
from jaxplore.tasks.exploration.settings import merge_entries
from jaxplore.tasks.registry import (
    build,
    files_of,
    find_kind,
    folder_name,
    keep_read,
    make_settings,
    words,
)

LONGEST_NAME = 60
"""Longest name of the default folder of several maps, before `-comparison`."""
_OF_MAPS = ("starts", "batch")
"""Options for --maps only."""
_OF_ONE_PLACE = {
    "map_": "the map",
    "path_file": "--path",
    "start": "--start",
    "goal": "--goal",
}
"""Options for a single scenario only."""


def run_comparison(
    options: dict[str, Any], seeds: int, out: Path | None, *, overwrite: bool
) -> None:
    """Compare variants, write the folder of the comparison and print its tables.

    With --maps the exit code is 1 if runs failed, and 130 if the user stopped it.
    """
    pictures = take_pictures(options)
    limit = memory_limit(options)
    check_count("--seeds", seeds, MOST_SEEDS)
    variants = make_variants(
        _names(options.pop("architectures")),
        _names(options.pop("variants")),
        options.pop("varied"),
        is_trusted=options["trust"],
    )
    given = {name: options.pop(name) for name in ("maps", *_OF_MAPS, *RUNNER)}
    runner = make_runner(given)
    if given["maps"] is not None:
        if pictures.film != FilmOptions():
            raise ValueError("--fps or --film-scale is given beside --maps, which draws no film; "
                             "accepted: without --maps")  # fmt: skip
        kinds = pictures.figures
        _on_maps(options, given, variants, seeds, out, runner, kinds, limit, overwrite=overwrite)
        return
    for name in _OF_MAPS:
        if given[name] is not None:
            raise ValueError(f"--{name} is {given[name]}; accepted: with --maps")
    _in_one_place(options, pictures, variants, seeds, out, runner, limit, overwrite=overwrite)


def _names(text: str | None) -> list[str]:
    return [] if text is None else [name.strip() for name in text.split(",")]


def _in_one_place(
    options: dict[str, Any],
    pictures: Pictures,
    variants: Mapping[str, dict[str, Any]],
    seeds: int,
    out: Path | None,
    runner: Runner,
    limit: float,
    *,
    overwrite: bool,
) -> None:
    samples = options.pop(SAMPLES)
    entries = option_entries(options)
    if not variants:
        variants = {
            name: {"architecture": name} for name in find_kind(entries).architectures(entries)
        }
    if not variants:
        raise ValueError(
            "--vary is missing; accepted here: --vary NAME=A,B or --variants FILE,FILE"
        )
    entries = with_samples(entries, samples, options["assignments"], variants.values())
    given = keep_read({name: merge_entries(entries, own) for name, own in variants.items()})
    check_memory(map(make_settings, given.values()), limit, num_runs=runner.num_processes)
    started = {name: find_kind(each).with_start(each) for name, each in given.items()}
    settings = {name: make_settings(each) for name, each in started.items()}
    _check_one_robot(settings)
    common = next(iter(settings.values()))
    folder = free_name(Path("runs") / f"{folder_name(entries)}-comparison") if out is None else out
    # The folder is checked before the runs, which may take hours.
    reserve(folder, overwrite=overwrite)
    # The keys are left out: `compare` makes one for each seed.
    experiments = {name: build(each)[:3] for name, each in settings.items()}
    show_starts(given, started)
    first = common.seed
    check_number_of_seeds("--seeds", range(first, first + seeds))
    result = compare(experiments, range(first, first + seeds), runner=runner, progress=True)
    kept = _shared_settings(entries, settings.values())
    own = {
        name: read_values(settings[name])
        for name, each in variants.items()
        if set(each) != {"architecture"}
    }
    with progress_bar("drawing", enabled=pictures.animation) as advance:
        result.save(
            folder,
            overwrite=overwrite,
            animation=pictures.animation,
            film=pictures.film,
            figures=pictures.figures,
            settings={name: each for name, each in kept.items() if name != "architecture"},
            variants=own,
            on_progress=lambda share: advance(share, ""),
        )
    show_comparison(result, folder)


def _shared_settings(entries: dict[str, Any], runs: Iterable[RunSettings]) -> dict[str, Any]:
    """Return what the runs read of the entries that they share, with defaults.

    Defaults depend on the architecture: where two runs have others, those of the first are kept.
    """
    kind = find_kind(entries)
    found: dict[str, Any] = {}
    for run in runs:
        architecture = getattr(run, "architecture", None)
        own = {} if architecture is None else {"architecture": architecture}
        settings = kind.make_settings(kind.with_start({**entries, **own}))
        found = merge_entries(read_values(settings), found)
    return found


def _check_one_robot(settings: Mapping[str, RunSettings]) -> None:
    names = {name: getattr(each, "architecture", None) for name, each in settings.items()}
    ground = [name for name, architecture in names.items() if architecture not in QUADROTOR]
    robots = [each.model_dump(include={"robot", "lidar"}) for each in settings.values()]
    if all(each == robots[0] for each in robots):
        return
    if ground and len(ground) < len(names):
        raise ValueError(
            f"--architectures is {','.join(names)!r}, of which {', '.join(ground)} drives another "
            f"robot with another sensor; accepted: {', '.join(GROUND)}, or of the others"
        )


def _on_maps(
    options: dict[str, Any],
    given: dict[str, Any],
    variants: Mapping[str, dict[str, Any]],
    seeds: int,
    out: Path | None,
    runner: Runner,
    kinds: Sequence[str],
    limit: float,
    *,
    overwrite: bool,
) -> None:
    named = options["map_"] if options["map_"] in words() else None
    for name, shown in _OF_ONE_PLACE.items():
        if options[name] not in (None, named):
            raise ValueError(
                f"{shown} is {options[name]} beside --maps; accepted: one of them, and --starts"
            )
    samples = options.pop(SAMPLES)
    maps = maps_in(given["maps"], None if named is None else find_kind(words()[named]))
    if given["starts"] is not None:
        maps = with_starts(maps, given["starts"])
    entries = option_entries({**options, "map_": None}, {maps[0].selector: maps[0].path}, named)
    kind = find_kind(entries)
    compared = files_of(kind.selector)
    first = entries.get("seed", 0)
    if not isinstance(first, int):
        raise ValueError(f"setting seed is {first!r}; accepted: a whole number >= 0")
    batch = 1 if given["batch"] is None else given["batch"]
    check_count("--batch", batch, MOST_AT_ONCE)
    if not variants and not compared.variants:
        raise ValueError(
            "--vary is missing; accepted here: --vary NAME=A,B or --variants FILE,FILE"
        )
    # A variant without an architecture of its own is named by it.
    own_entries = {
        name: {"architecture": name, **own} if compared.variants else own
        for name, own in variant_entries(variants or compared.variants, kind).items()
    }
    entries = with_samples(entries, samples, options["assignments"], own_entries.values())
    seeds_of_all = range(first, first + seeds)
    check_number_of_seeds("--seeds", seeds_of_all)
    plan = Plan(maps, variants or compared.variants, tuple(seeds_of_all), entries, batch)
    settings = {
        (each.map, each.explorer): make_settings(each.entries)
        for each in plan.with_protocol().episodes()
        if each.seed == first
    }
    for each in settings.values():
        # The runs on a map that cannot be read fail, and the others go on.
        check_memory(
            [each], limit, num_runs=runner.num_processes, batch=batch, must_be_readable=False
        )
    folder = _default_folder(given["maps"]) if out is None else out
    found = compare_maps(
        plan, folder, runner=runner, overwrite=overwrite, figures=kinds, progress=True
    )
    _show(found)


def _default_folder(maps: str) -> Path:
    """Return the default folder for the results of a folder of maps, or of several places.

    If only one with the default name of former versions exists, it raises a `ValueError`.
    """
    parts = [maps] if "," not in maps or os.path.lexists(maps) else maps.split(",")
    stems = [Path(os.path.realpath(part.strip())) for part in parts]
    name = "-".join(stem.name if stem.is_dir() else stem.stem for stem in stems)[:LONGEST_NAME]
    folder, former = Path("runs") / f"{name}-comparison", Path("runs") / f"{name}-benchmark"
    if former.is_dir() and not folder.exists():
        raise ValueError(f"{former} is of a former version; accepted: --out {former}, or rename it")
    return folder


def _show(found: MapComparison) -> None:
    for table in found.tables:
        say(table.title)
        print_table(table.rows, has_lines=True)
    say(str(found.results))
    say(str(found.page))
    for line in found.failures:
        say(line, err=True)
    counts = found.counts
    if counts.is_interrupted:
        say(
            f"Interrupted: {counts.num_former + counts.num_done} of {found.num_episodes} runs are "
            "done; the same command continues.",
            err=True,
        )
        sys.exit(INTERRUPTED)
    if counts.num_failed:
        sys.exit(FAILED)
