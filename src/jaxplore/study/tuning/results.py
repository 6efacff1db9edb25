"""What a search leaves in its folder: settings, tables, pictures and a page."""

import base64
import csv
import html
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from jaxplore.report.compute import software
from jaxplore.report.folder import write_whole
from jaxplore.study.tuning.evidence import Change, changes, table, verdict
from jaxplore.study.tuning.objective import Numbers
from jaxplore.study.tuning.pictures import figures, importances, png
from jaxplore.study.tuning.strategies import Diversity
from jaxplore.study.tuning.study import Study
from jaxplore.study.tuning.trials import Trial

SETTINGS, RECORD, PAGE = "settings.yaml", "record.yaml", "report.html"
"""Settings for `jaxplore run --settings`; how they were found, in short; and to look at."""
TRIALS, UNSEEN, FRONT, ARCHIVE = "trials.csv", "unseen.csv", "front.csv", "archive.csv"
"""All candidates; the seeds that were not tuned on; compromises; the best of each cell."""
ANIMATION = "before_after.gif"
_WHAT = "study folder"

type Unseen = Mapping[tuple[str, int], Numbers]


def write_text(folder: Path, name: str, text: str) -> Path:
    """Write a text file into a study's folder, whole or not at all, and return its path."""
    target = folder / name
    write_whole(target, lambda file: file.write(text.encode()), _WHAT)
    return target


def write_bytes(folder: Path, name: str, data: bytes) -> Path:
    """Write a file into a study's folder, whole or not at all, and return its path."""
    target = folder / name
    write_whole(target, lambda file: file.write(data), _WHAT)
    return target


def record(study: Study, chosen: Trial, before: Unseen, after: Unseen) -> dict[str, Any]:
    """Return how settings were found and what they are worth, in plain values.

    Args:
        study: the search.
        chosen: the candidate.
        before: metrics of the settings that there were, with seeds that were not tuned on.
        after: of the chosen ones.
    """
    trials = study.trials()
    states = ("done", "given up", "failed")
    seeds = sorted({seed for _, seed in before})
    found = changes(study.search.objectives, before, after)
    return {
        "search": study.search.describe(),
        "candidates": {state: sum(each.state == state for each in trials) for state in states},
        "before": {name: _short(value) for name, value in study.before.items()},
        "chosen": {
            "number": chosen.number,
            "values": {name: _short(value) for name, value in chosen.candidate.items()},
            "objective on tuned seeds": [_short(value) for value in chosen.values],
        },
        "importance": {name: _short(share) for name, share in importances(study).items()},
        "unseen seeds": seeds,
        "changes on unseen seeds": {
            each.name: {
                "before": _short(each.before),
                "after": _short(each.after),
                "difference": _short(each.difference),
                "interval": [_short(each.low), _short(each.high)],
            }
            for each in found
        },
        "software": {
            name: value for name, value in software().items() if name in ("jaxplore", "jax")
        },
    }


def write_results(
    study: Study,
    chosen: Trial,
    before: Unseen,
    after: Unseen,
    folder: Path,
    *,
    title: str,
    animation: bytes | None = None,
) -> list[Path]:
    """Write tables, pictures, the record and the page, and return their paths.

    Args:
        study: the search.
        chosen: the candidate that the settings are of.
        before: metrics of the settings that there were, with seeds that were not tuned on.
        after: of the chosen ones.
        folder: of the study.
        title: of the page.
        animation: GIF of a run before and after.

    Raises:
        ValueError: the folder cannot be written.
    """
    told = record(study, chosen, before, after)
    paths = [
        write_text(folder, RECORD, yaml.safe_dump(told, sort_keys=False, allow_unicode=True)),
        write_text(folder, TRIALS, _csv(_trial_rows(study, study.trials()))),
        write_text(folder, UNSEEN, _csv(table(study.search.objectives, before, after))),
    ]
    if len(study.search.objectives) > 1:
        paths.append(write_text(folder, FRONT, _csv(_trial_rows(study, study.front()))))
    if isinstance(study.strategy, Diversity):
        paths.append(write_text(folder, ARCHIVE, _csv(_archive_rows(study, study.strategy))))
    pictures = {f"{name}.png": png(figure) for name, figure in figures(study, chosen).items()}
    if animation is not None:
        pictures = {ANIMATION: animation, **pictures}
    paths += [write_bytes(folder, name, data) for name, data in pictures.items()]
    found = changes(study.search.objectives, before, after)
    paths.append(
        write_text(folder, PAGE, _page(study, chosen, found, pictures, title, len(before)))
    )
    return paths


def _trial_rows(study: Study, trials: Sequence[Trial]) -> list[dict[str, Any]]:
    names = [str(each) for each in study.search.objectives]
    return [
        {
            "number": each.number,
            "state": each.state,
            **dict.fromkeys(names, ""),
            **dict(zip(names, each.values, strict=False)),
            **each.candidate,
            "episodes": len(each.episodes),
            "error": each.error or "",
        }
        for each in trials
    ]


def _archive_rows(study: Study, strategy: Diversity) -> list[dict[str, Any]]:
    data = strategy.archive.data(["solution", "objective", "measures"])
    rows = [
        {
            **{
                each.metric: float(value)
                for each, value in zip(study.search.measures, measures, strict=True)
            },
            str(study.search.objectives[0]): -float(value),
            **study.search.space.candidate(solution),
        }
        for solution, value, measures in zip(
            data["solution"], data["objective"], data["measures"], strict=True
        )
    ]
    return sorted(rows, key=lambda row: tuple(row[each.metric] for each in study.search.measures))


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    file = io.StringIO()
    columns = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(file, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return file.getvalue()


def _short(value: Any) -> Any:
    """Return a number with the digits that mean something."""
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else None
    return value


_STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;
color:#222}table{border-collapse:collapse;margin:1rem 0}th,td{border-bottom:1px solid #ddd;
padding:.25rem .8rem;text-align:right}th:first-child,td:first-child{text-align:left}
img{max-width:100%;border:1px solid #eee;margin:.5rem 0}.sure{font-weight:600}"""


def _page(
    study: Study,
    chosen: Trial,
    found: Sequence[Change],
    pictures: Mapping[str, bytes],
    title: str,
    num_episodes: int,
) -> str:
    start = study.before
    values = [
        (name, _text(start[name]), _text(chosen.candidate[name]))
        for name in study.search.space.names
    ]
    rows = [
        (
            each.name,
            _text(each.before),
            _text(each.after),
            f"{each.difference:+.4g} [{each.low:+.4g}, {each.high:+.4g}]",
        )
        for each in found
    ]
    done = sum(each.state == "done" for each in study.trials())
    objectives = " and ".join(map(str, study.search.objectives))
    parts = [
        f"<h1>{html.escape(title)}</h1>",
        f"<p>Least {html.escape(objectives)} by {html.escape(study.search.optimizer)}: "
        f"{len(study.trials())} candidates, {done} of them tried out to the end, each in "
        f"{len(study.search.seeds)} x {len(study.episodes.scenarios)} episodes. "
        f"Chosen is number {chosen.number}.</p>",
        "<h2>Settings</h2>",
        _html_table(("", "before", "after"), values),
        f"<p>{verdict(chosen.number, study.search.objectives, found)}</p>",
        f"<h2>Seeds that were not tuned on: {num_episodes} episodes</h2>",
        _html_table(("mean", "before", "after", "difference [95 % interval]"), rows),
    ]
    for name, data in pictures.items():
        kind = "gif" if name.endswith(".gif") else "png"
        code = base64.b64encode(data).decode()
        heading = name.rpartition(".")[0].replace("_", " and ").replace("-", " ").capitalize()
        parts.append(
            f"<h2>{html.escape(heading)}</h2>"
            f'<img alt="{html.escape(heading)}" src="data:image/{kind};base64,{code}">'
        )
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body>"
        + "\n".join(parts)
        + "</body></html>\n"
    )


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _html_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def line(cells: Sequence[str], kind: str) -> str:
        return "<tr>" + "".join(f"<{kind}>{html.escape(each)}</{kind}>" for each in cells) + "</tr>"

    return "<table>" + line(header, "th") + "".join(line(row, "td") for row in rows) + "</table>"
