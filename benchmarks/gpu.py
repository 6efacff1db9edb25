"""A GPU, and the CPU beside it: commands, an information field, steps of closed loops.

Where JAX's device is a GPU, the same is measured again in a process that has the CPU alone. Without
a GPU the columns of the CPU are empty, as all times are its own.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import portfolio_step
from benchmarks.control_problems import build, map_problem, quadrotor_problem, timed_step
from benchmarks.portfolio_step import loop_of
from benchmarks.setting import SMALL, SMALL_OFFICE, Site, available_sites, experiment
from benchmarks.tables import Rows
from benchmarks.timing import TimedLoop, measure_cases, percentiles, timed
from jaxplore import Euler, FieldSensor, InverseSensorModel, Lidar, OccupancyGrid, office

PUBLISHED = {1024: 0.131, 2048: 0.146, 4096: 0.170, 8192: 0.232, 16384: 0.389}
"""Times of a command of MPPI-Generic on an RTX 4090 by number of samples [ms]: a differential drive
on a map of costs, steps of 0.02 s, T = 100. Source: arXiv 2409.07563."""
MOST_TIMES = 3.0
"""How many times as long a command may take."""
RESOLUTION, RANGE = 0.1, 5.0
"""Side of a cell of the information field, and range of its beams [m]."""


class Sizes(NamedTuple):
    """What is measured, and how often on either device."""

    map_samples: tuple[int, ...] = tuple(PUBLISHED)
    map_horizon: int = 100
    cell: float = 0.05
    quadrotor_samples: tuple[int, ...] = (1000, 100_000)
    horizon: int = 40
    nodes: int = 200
    directions: int = 64
    site: Site = available_sites()[0]
    changes: dict[str, Any] = {}  # noqa: RUF012
    chunk: int = 50
    portfolio: portfolio_step.Sizes = portfolio_step.FULL._replace(counts=(8,))
    steps: int = 500
    runs: int = 300
    cpu_steps: int = 300
    cpu_runs: int = 30


FULL = Sizes()
SMOKE = Sizes(
    map_samples=(8,),
    map_horizon=4,
    cell=0.2,
    quadrotor_samples=(8,),
    horizon=4,
    nodes=80,
    directions=4,
    site=SMALL_OFFICE,
    changes=SMALL,
    chunk=25,
    portfolio=portfolio_step.SMOKE,
    steps=25,
    runs=4,
    cpu_steps=25,
    cpu_runs=2,
)
TITLES = {"times": "A GPU, and the CPU beside it"}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return the times on the device that JAX has, and on a CPU beside it."""
    rows = _times(sizes)
    beside: list[dict[str, Any]] = [{}] * len(rows)
    if jax.default_backend() != "cpu":
        fewer = sizes._replace(steps=sizes.cpu_steps, runs=sizes.cpu_runs)
        # JAX reads which devices it may use when it starts.
        on_cpu = {"JAX_PLATFORMS": "cpu"}
        (found,) = measure_cases(measure_times, [[fewer._asdict()]], environment=on_cpu)
        beside = found["times"]
    return {"times": joined(rows, beside)}


def joined(rows: Rows, beside: Rows) -> Rows:
    """Return rows with the times of the same on a CPU in front of what is wanted.

    Args:
        rows: what was measured.
        beside: the same in the same order on a CPU; rows without times where there is none.
    """
    return [
        {
            **{name: value for name, value in row.items() if name not in _ENDING},
            "cpu_p50_ms": cpu.get("p50_ms"),
            "cpu_p99_ms": cpu.get("p99_ms"),
            **{name: row[name] for name in _ENDING},
        }
        for row, cpu in zip(rows, beside, strict=True)
    ]


_ENDING = ("wanted_ms", "MPPI-Generic on an RTX 4090")


def _times(sizes: Sizes) -> Rows:
    return [*_commands(sizes), _field(sizes), *_exploration(sizes), _portfolio(sizes)]


def _row(
    name: str,
    seconds: list[float],
    compile_seconds: float,
    wanted_ms: float | None = None,
    published_ms: float | None = None,
) -> dict[str, Any]:
    return {
        "": name,
        "device": jax.devices()[0].device_kind,
        **percentiles(seconds),
        "compile_seconds": compile_seconds,
        **dict(zip(_ENDING, (wanted_ms, published_ms), strict=True)),
    }


def _commands(sizes: Sizes) -> Rows:
    """Commands of one controller, called from Python.

    The differential drive takes Euler steps, as the one of MPPI-Generic does.
    """
    rows = []
    for samples in sizes.map_samples:
        problem = map_problem(samples, sizes.map_horizon, sizes.cell)
        took = timed_step(build(problem, integrator=Euler()), problem["start"], sizes.runs)
        published = PUBLISHED.get(samples)
        wanted = None if published is None else MOST_TIMES * published
        name = f"differential drive on a map, K = {samples}, T = {sizes.map_horizon}"
        rows.append(_row(name, took.seconds, took.compile_seconds, wanted, published))
    for samples in sizes.quadrotor_samples:
        problem = quadrotor_problem(samples, sizes.horizon)
        took = timed_step(build(problem), problem["start"], sizes.runs)
        wanted = {1000: 0.3, 100_000: 5.0}.get(samples)
        name = f"quadrotor, K = {samples}, T = {sizes.horizon}"
        rows.append(_row(name, took.seconds, took.compile_seconds, wanted))
    return rows


def _field(sizes: Sizes) -> dict[str, Any]:
    """The information of all headings at all cells of an office of which half is known."""
    side = sizes.nodes * RESOLUTION
    known = np.array(office(width=side, height=side, resolution=RESOLUTION).probability)
    known[:, known.shape[1] // 2 :] = 0.5
    grid = OccupancyGrid(jnp.asarray(known), RESOLUTION)
    lidar = Lidar(max_range=RANGE, range_noise=0.02)
    sensor = FieldSensor(lidar, RESOLUTION, sizes.directions)
    took = timed(sensor.field, grid, InverseSensorModel(), runs=sizes.runs)
    nodes = " x ".join(map(str, known.shape))
    name = f"information field, {nodes} nodes, {sizes.directions} directions"
    return _row(name, took.seconds, took.compile_seconds, 1.0)


def _exploration(sizes: Sizes) -> Rows:
    """The step of the default explorer, as the section `control_step` measures it."""
    controller, scenario, _, key = experiment(sizes.site, target_coverage=1.0, **sizes.changes)
    loop = TimedLoop(controller, scenario, key, sizes.chunk)
    compiling = loop.run(0)
    loop.run(sizes.chunk)
    chunks, single = loop.turns(sizes.steps)
    name = f"a step of exploration, {sizes.site.name}"
    return [
        _row(f"{name}, one at a time", single, compiling, 1.5),
        _row(f"{name}, in chunks of {sizes.chunk}", chunks, compiling),
    ]


def _portfolio(sizes: Sizes) -> dict[str, Any]:
    """The step of the section `portfolio`, for which 200 Hz are wanted."""
    members, samples, horizon = sizes.portfolio.counts[0], *sizes.portfolio[1:3]
    loop = loop_of(members, samples, horizon, sizes.portfolio.place, sizes.portfolio.chunk)
    compiling = loop.run(0)
    loop.run(loop.chunk)
    single = [loop.run(1) for _ in range(sizes.steps)]
    name = f"a step of a portfolio, N = {members}, K = {samples}, T = {horizon}"
    return _row(name, single, compiling, 5.0)


def measure_times(given: dict[str, Any]) -> dict[str, Any]:
    """Return the times on the devices of this process.

    Args:
        given: sizes, as JSON holds them.
    """
    site, portfolio = Site(*given["site"]), portfolio_step.Sizes(*given["portfolio"])
    return {"times": _times(Sizes(**{**given, "site": site, "portfolio": portfolio}))}
