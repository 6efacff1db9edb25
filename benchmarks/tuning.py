"""Episodes of a search per second: a population side by side by `vmap`, and one by one.

An evolution strategy of evosax proposes the candidates; both ways try out the same ones, with the
same seed for all of a generation, and end with the same reports. One by one is the compiled closed
loop of `simulate` or `simulate`, one candidate after the other, nothing compiled anew; its
controller is the base with other numbers, as in the batch. Times are of the episodes of whole
generations with their reports, without the compilation; and beside that with what a search does in
between: proposing, keeping, telling.

The problems grow: a point mass with a quadratic cost, which is a function (`VectorEpisodes`; one by
one it is a batch of 1); a car along the generated track with few rollouts; an
explorer in a small office.
"""

import dataclasses
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

import jaxplore as jx
from benchmarks import sensitivity
from benchmarks.tables import Rows
from jaxplore._types import Key
from jaxplore.study.tuning import (
    ControllerEpisodes,
    Episode,
    Episodes,
    Objective,
    Parameter,
    Result,
    Search,
    Space,
    VectorEpisodes,
    open_study,
)
from jaxplore.tasks.path.settings import make_path_settings
from jaxplore.tasks.registry import build, make_settings


@dataclasses.dataclass(frozen=True)
class Problem:
    """What is tuned: episodes by the size of their batch, what is searched and for what."""

    name: str
    episodes: Callable[[int], Episodes]
    parameters: tuple[str, ...]
    objective: str
    population: int


class Sizes(NamedTuple):
    """Problems, generations timed of each after two that compile and warm up, and the sizes of
    `benchmarks.sensitivity`."""

    problems: Callable[[], Sequence[Problem]]
    rounds: int
    settings: sensitivity.Sizes


FULL = Sizes(lambda: (_point_mass(64), _track(64), _office()), 3, sensitivity.FULL)
SMOKE = Sizes(lambda: (_point_mass(4),), 1, sensitivity.SMOKE)
TITLES = {
    "episodes": "Episodes of a search, a population side by side and one by one",
    "sensitivity": "One setting at a time, times as long as with the default",
}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return a row for each problem, and the effect of settings."""
    rows = [_row(problem, sizes.rounds) for problem in sizes.problems()]
    return {"episodes": rows, "sensitivity": sensitivity.measure(sizes.settings)}


def _row(problem: Problem, rounds: int) -> dict[str, Any]:
    rates: dict[str, list[tuple[float, float]]] = {}
    # In turn, so that a busy minute of the machine is not one way's alone.
    together, alone = _generations(problem, problem.population), _generations(problem, 1)
    for _ in range(rounds):
        for name, generation in (("vmap", together), ("one by one", alone)):
            rates.setdefault(name, []).append(generation())
    side, one = (
        [statistics.median(column) for column in zip(*rates[name], strict=True)]
        for name in ("vmap", "one by one")
    )
    return {
        "problem": problem.name,
        "population": problem.population,
        "episodes_per_second_vmap": side[0],
        "episodes_per_second_one_by_one": one[0],
        "times_as_many": side[0] / one[0],
        "times_as_many_with_the_search": side[1] / one[1],
        "repeats": [1.0 / rate for rate, _ in rates["vmap"]],
    }


def _generations(problem: Problem, batch: int) -> Callable[[], tuple[float, float]]:
    """Return what runs one more generation, and returns episodes per second: those of the episodes
    alone, and those of the whole search."""
    episodes = problem.episodes(batch)
    run, spent = episodes.run, 0.0

    def timed(asked: Sequence[Episode], on_result: Callable[[Episode, Result], None]) -> None:
        nonlocal spent
        results: list[tuple[Episode, Result]] = []
        began = time.perf_counter()
        run(asked, lambda episode, result: results.append((episode, result)))
        spent = time.perf_counter() - began
        for episode, result in results:
            on_result(episode, result)

    episodes.run = timed  # type: ignore[method-assign, assignment]
    parameters = tuple(
        Parameter(name, 0.5 * float(start), 2.0 * float(start), is_log=True)
        for name in problem.parameters
        for start in [episodes.start(name)]
    )
    search = Search(
        Space(parameters),
        (Objective.parse(problem.objective),),
        (0,),
        "cma-es",
        population=problem.population,
        gives_up=False,
    )
    stack = open_study(search, episodes)
    study = stack.__enter__()  # for as long as this program runs
    # Twice: the optimizer is told for the first time when the second generation is asked for.
    done = 2 * problem.population
    study.run(done)

    def generation() -> tuple[float, float]:
        nonlocal done
        done += problem.population
        began = time.perf_counter()
        study.run(done)
        whole = time.perf_counter() - began
        return problem.population / spent, problem.population / whole

    return generation


def _point_mass(population: int) -> Problem:
    robot = jx.PointMass(2, max_acceleration=4.0)
    cost = jx.StateCost({"x": 1.0, "y": 1.0}) + 0.1 * jx.costs.QuadraticControlCost([1.0, 1.0])
    controller = jx.MPPI(
        robot, cost, horizon=10, num_samples=32, temperature=1.0, noise_std=[1.0, 1.0], dt=0.1
    )

    def episode(values: dict[str, Array], key: Key) -> dict[str, Array]:
        tuned = jx.set_parameters(
            controller,
            {
                "weighting.temperature": values["temperature"],
                "proposal.noise_std": values["noise"],
            },
        )

        def step(carry: Any, key: Key) -> tuple[Any, Array]:
            memory, state = carry
            control, memory, _ = tuned.step(memory, state, key=key)
            state = tuned.dynamics.step(state, control, tuned.dt)
            return (memory, state), jnp.sum(state[:2] ** 2) + 0.1 * jnp.sum(control**2)

        start = (tuned.init(), jnp.array([1.0, -0.5, 0.0, 0.0]))
        return {"cost": jax.lax.scan(step, start, jax.random.split(key, 100))[1].mean()}

    return Problem(
        "point mass, 32 rollouts x 10 steps, 100 commands",
        lambda batch: VectorEpisodes(episode, {"temperature": 0.3, "noise": 1.0}, batch=batch),
        ("temperature", "noise"),
        "cost",
        population,
    )


def _track(num_samples: int) -> Problem:
    built = build(make_path_settings({"controller": {"num_samples": num_samples}}))
    return Problem(
        f"car along a track, {num_samples} rollouts x 30 steps, about 650 commands",
        lambda batch: ControllerEpisodes(
            built.controller, {"track": built.scenario}, time_limit=20.0, batch=batch
        ),
        ("weighting.temperature", "cost.progress.weight", "cost.comfort.weight"),
        "finished_at",
        32,
    )


def _office() -> Problem:
    settings = {"map": "office", "office": {"width": 10.0, "height": 8.0}}
    rates = {"rates": {"control": 20.0}, "controller": {"num_samples": 100}}
    built = build(make_settings({**settings, **rates}))
    return Problem(
        "explorer in an office of 10 x 8 m, 100 rollouts x 40 steps, 400 commands",
        lambda batch: ControllerEpisodes(
            built.controller, {"office": built.scenario}, time_limit=20.0, batch=batch
        ),
        ("weighting.temperature", "cost.guidance.weight", "cost.information.weight"),
        "time_to.90",
        16,
    )


if __name__ == "__main__":
    print(*measure(FULL)["episodes"], sep="\n")
