"""Short runs of every kind, kept to show that a change of structure changes no number.

`python -m benchmarks.frozen save FOLDER` before it, `python -m benchmarks.frozen check FOLDER`
after it, on the same machine. Maps of others come from `JAXPLORE_MAPS`.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
import yaml

from benchmarks.setting import available_maps
from jaxplore.simulation.run import record_run
from jaxplore.tasks.exploration.settings import scenario_path
from jaxplore.tasks.registry import build, make_settings

SECONDS = 15.0
"""Simulated time of a run [s]."""


def runs() -> dict[str, dict[str, Any]]:
    """Return the settings of the runs by name."""
    drift = {"odometry": "wheels"}
    found: dict[str, dict[str, Any]] = {
        "office": {"map": "office"},
        "car": {"map": "office", "robot": {"model": "ackermann"}},
        "drift": {"map": "office", "localisation": drift},
        "people": {"map": "office", "people": {"number": 4, "speed": 1.0}},
        "fleet": {"map": "office", "fleet": {"robots": 3}, "guard": False, "target_coverage": 0.99},
        "guarded-fleet": {"map": "office", "fleet": {"robots": 3}, "target_coverage": 0.99},
        "two-layer": {"map": "zones", "architecture": "two-layer"},
        "parallel": {"map": "zones", "architecture": "parallel"},
        "path": {"path": "track", "obstacles": {"number": 3}},
        "forest": {"volume": "forest"},
    }
    for name in ("warehouse", "search-rescue", "perimeter"):
        found[name] = yaml.safe_load(scenario_path(name).read_text(encoding="utf-8"))
    for name, path in available_maps({"depot": "nav2_depot/depot.yaml"}).items():
        found[name] = {"map": str(path)}
    return found


def arrays(entries: dict[str, Any]) -> dict[str, np.ndarray]:
    """Return all that is recorded of a run, by name."""
    made = build(make_settings({**entries, "time_limit": SECONDS, "seed": 3}))
    run = record_run(*made[:3], key=made.key)
    leaves = jax.tree_util.tree_leaves_with_path(run.records)
    found = {jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves}
    metrics = run.metrics()
    for name, value in metrics.as_dict().items():
        if isinstance(value, int | float) and not name.endswith(("_ms", "_seconds")):
            found[f"metrics.{name}"] = np.asarray(value)
    return found


def differences(before: dict[str, np.ndarray], after: dict[str, np.ndarray]) -> list[str]:
    """Return what differs, in words; nothing if all is equal to the bit."""
    said = []
    for name in sorted(before.keys() & after.keys()):
        one, other = before[name], after[name]
        if one.shape != other.shape:
            said.append(f"{name} has shape {other.shape}, had {one.shape}")
        elif one.tobytes() != other.tobytes():
            apart = np.abs(one.astype(np.float64) - other.astype(np.float64))
            first = np.argwhere(np.atleast_1d(one != other))[:1].tolist()
            said.append(f"{name} differs by {np.nanmax(apart):.3g}, first at {first}")
    # Names come last: a change of names alone shows then that no number has changed.
    said += [f"{name} is gone" for name in sorted(before.keys() - after.keys())]
    return said + [f"{name} is new" for name in sorted(after.keys() - before.keys())]


def main() -> None:
    """Keep the runs, or compare them with those that were kept."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("action", choices=("save", "check"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", help="names of runs")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    is_equal = True
    for name, entries in runs().items():
        if given.only and name not in given.only:
            continue
        path = given.folder / f"{name}.npz"
        found = arrays(entries)
        if given.action == "save":
            np.savez(path, allow_pickle=False, **found)
            print(f"{name}: {len(found)} arrays", flush=True)
            continue
        with np.load(path, allow_pickle=False) as kept:
            said = differences(dict(kept), found)
        is_equal &= not said
        print(f"{name}: {'; '.join(said[:6]) or 'equal to the bit'}", flush=True)
    sys.exit(not is_equal)


if __name__ == "__main__":
    main()
