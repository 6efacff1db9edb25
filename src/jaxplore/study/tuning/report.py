"""The folder of a search: settings, tables, figures and a page."""

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
from jaxplore.report.drawing.figure import PNG, figure_bytes
from jaxplore.report.folder import write_whole
from jaxplore.report.table import to_html
from jaxplore.study.tuning.optimizers import RibsOptimizer
from jaxplore.study.tuning.pictures import figures, importances
from jaxplore.study.tuning.result import TuningResult
from jaxplore.study.tuning.settings_episodes import SettingsEpisodes
from jaxplore.study.tuning.significance import table
from jaxplore.study.tuning.study import Study
from jaxplore.study.tuning.trials import Trial

SETTINGS, RECORD, PAGE = "settings.yaml", "record.yaml", "report.html"
"""Settings for `jaxplore run --settings`, a summary of the search, and the page."""
TRIALS, UNSEEN, FRONT, ARCHIVE = "trials.csv", "unseen.csv", "front.csv", "archive.csv"
"""Tables: all candidates, the episodes on unseen seeds, the Pareto front, the archive."""
ANIMATION = "before_after.gif"
_WHAT = "study folder"


def write_settings(study: Study, chosen: Trial, folder: Path) -> Path | None:
    """Write the settings of a candidate and return the path; None if no settings were tuned."""
    if not isinstance(study.episodes, SettingsEpisodes):
        return None
    entries = study.episodes.make_entries(chosen.candidate)
    text = yaml.safe_dump(entries, sort_keys=False, allow_unicode=True)
    return _write(folder / SETTINGS, text.encode())


def _write(target: Path, data: bytes) -> Path:
    write_whole(target, lambda file: file.write(data), _WHAT)
    return target


def record(study: Study, found: TuningResult) -> dict[str, Any]:
    """Summarise a search as plain values: its definition and its result."""
    trials = study.trials()
    states = ("done", "given up", "failed")
    seeds, chosen = sorted({seed for _, seed in found.before}), found.chosen
    return {
        "search": study.search.describe(),
        "candidates": {state: sum(each.state == state for each in trials) for state in states},
        "before": {name: _short(value) for name, value in found.current.items()},
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
            for each in found.changes
        },
        "verdict": found.verdict,
        "software": {
            name: value for name, value in software().items() if name in ("jaxplore", "jax")
        },
    }


def write_results(
    study: Study,
    found: TuningResult,
    folder: Path,
    *,
    title: str,
    animation: bytes | None = None,
    kinds: Sequence[str] = (PNG,),
) -> list[Path]:
    """Write tables, figures, the summary and the page, and return their paths.

    `animation` is a GIF of runs before and after. `kinds` are the formats of the figures; the page
    shows them as PNG.
    """
    text = yaml.safe_dump(record(study, found), sort_keys=False, allow_unicode=True)
    texts = {
        RECORD: text,
        TRIALS: _csv(_trial_rows(study, found.trials)),
        UNSEEN: _csv(table(study.search.objectives, found.before, found.after)),
    }
    if len(study.search.objectives) > 1:
        texts[FRONT] = _csv(_trial_rows(study, found.front))
    if isinstance(study.optimizer, RibsOptimizer):
        texts[ARCHIVE] = _csv(_archive_rows(study, study.optimizer))
    drawn = figures(study, found.chosen)
    pictures = {f"{name}.{PNG}": figure_bytes(each) for name, each in drawn.items()}
    copies = {
        f"{name}.{kind}": pictures.get(f"{name}.{kind}") or figure_bytes(each, kind)
        for name, each in drawn.items()
        for kind in kinds
    }
    if animation is not None:
        pictures, copies = {ANIMATION: animation, **pictures}, {ANIMATION: animation, **copies}
    files = {name: text.encode() for name, text in texts.items()} | copies
    files[PAGE] = _page(study, found, pictures, title).encode()
    return [_write(folder / name, data) for name, data in files.items()]


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


def _archive_rows(study: Study, optimizer: RibsOptimizer) -> list[dict[str, Any]]:
    data = optimizer.archive.data(["solution", "objective", "measures"])
    rows = [
        {
            **{
                each.metric: float(value)
                for each, value in zip(study.search.measures, measures, strict=True)
            },
            # pyribs maximises, so its archive holds minus the objective.
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
    """Round a number to five digits; None if it is not finite."""
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else None
    return value


_STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;
color:#222}table{border-collapse:collapse;margin:1rem 0}th,td{border-bottom:1px solid #ddd;
padding:.25rem .8rem;text-align:right}th:first-child,td:first-child{text-align:left}
img{max-width:100%;border:1px solid #eee;margin:.5rem 0}.sure{font-weight:600}"""


def _page(study: Study, found: TuningResult, pictures: Mapping[str, bytes], title: str) -> str:
    done = sum(each.state == "done" for each in found.trials)
    objectives = " and ".join(map(str, study.search.objectives))
    parts = [
        f"<h1>{html.escape(title)}</h1>",
        f"<p>Minimized {html.escape(objectives)} by {html.escape(study.search.optimizer)}: "
        f"{len(found.trials)} candidates, {done} of them evaluated to the end, each in "
        f"{len(study.search.seeds)} x {len(study.episodes.scenarios)} episodes. "
        f"Candidate {found.chosen.number} was chosen.</p>",
        "<h2>Settings</h2>",
        to_html(found.settings_rows()),
        f"<p>{html.escape(found.verdict)}</p>",
        f"<h2>Unseen seeds: {len(found.before)} episodes</h2>",
        to_html(found.change_rows()),
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
