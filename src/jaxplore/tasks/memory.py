"""Estimate the memory of a run from its settings, before anything is allocated or compiled.

The estimate is a sum of parts. With H x W cells of the map in arrays (see `choose_padded_shape`), N
nodes of the information field, D directions, B beams of R cells, K rollouts of T steps of nu
controls, S control periods and F frames, in bytes:

    programs    0.65e9                                Python, JAX and the compiled loop
    map         130 H W + 16 pixels of the image      the maps of the world and of the robot
    fields      18 N D + 40 (H + 2 R) (W + 2 R)       information by direction, and its margins
    beams       60 B R + 60 D R                       cells that the beams cross
    controller  8 K T nu + 200 K (1 + M)              of each member, among M obstacles or outcomes
    bank        128 K                                 stored numbers, of each member
    local       20 (N_f D_f + N_l D_l) + 40 (W_f + W_l)    fields around a quadrotor: nodes,
                                                      directions, cells with margins
    volume      60 D H W + 60 d h w                   the voxels of the world, and those of the map
                                                      in its window
    views       64 A N + 24 R                         fields of A headings at N nodes, R rays
    heard       12 M^2 H W                            maps of M robots that M robots have heard
    record      300 S                                 every step, in the file that it is read from
    frames      2 min(F (H W + 4 N), 1e9)             maps for the animation

A fleet needs all parts but the programs once per robot. The factors were measured, see
`docs/limits.md`: a run takes between half and twice the estimate.
"""

from typing import NamedTuple

from jaxplore.settings.controllers import (
    ContouringNumbers,
    ControllerSettings,
    InformativeSettings,
    PortfolioSettings,
)
from jaxplore.settings.robot import RobotSettings

PROGRAMS = 0.65e9
"""Memory of a process with a compiled loop [bytes]."""
_PROGRAMS = "programs"
CONTROLS = {
    "differential_drive": 2,
    "unicycle": 2,
    "ackermann": 2,
    "bicycle": 2,
    "omnidirectional": 3,
    "quadrotor": 4,
}
"""Number of controls by the model of the robot."""
_MOST_CONTROLS = 6
"""Number of controls of a model of the user's own."""
_BANK = 128.0
"""Memory of a bank of noise by the samples: 16 numbers for each, and a copy."""


class Part(NamedTuple):
    """A part of a run, named in words: its memory [bytes], and the settings with which it grows."""

    name: str
    settings: str
    size: float


def check_needs(
    parts: tuple[Part, ...], limit: float, *, num_runs: int = 1, batch: int = 1
) -> None:
    """Check that `num_runs` processes, with `batch` runs each, need at most `limit` bytes.

    The `ValueError` names the greatest part and its settings.
    """
    # The runs of a batch share their program.
    sizes = {
        part: num_runs * part.size * (1 if part.name == _PROGRAMS else batch) for part in parts
    }
    total = sum(sizes.values())
    if total <= limit:
        return
    greatest = max(parts, key=lambda part: sizes[part])
    who = "the run needs" if num_runs * batch == 1 else f"{num_runs * batch} runs at a time need"
    raise ValueError(
        f"{who} about {in_gigabytes(total)}, {in_gigabytes(sizes[greatest])} of it for the "
        f"{greatest.name} ({greatest.settings}); the limit is {in_gigabytes(limit)} "
        "(--memory-limit)"
    )


def in_gigabytes(size: float) -> str:
    """Return a memory [bytes] in words, such as `8.2 GB`."""
    return f"{size / 1e9:.3g} GB"


def estimate_programs() -> Part:
    """Estimate the memory of a process with a compiled loop."""
    return Part(_PROGRAMS, "every run", PROGRAMS)


def estimate_rollouts(
    section: str,
    robot: RobotSettings,
    given: ControllerSettings | PortfolioSettings | InformativeSettings | ContouringNumbers,
    *,
    members: int = 1,
    progress: int = 0,
    hindrances: int = 0,
) -> Part:
    """Estimate the memory of rollouts, of a number of members and among a number of obstacles.

    `section` names the settings of the controller, and `progress` counts the controls beside those
    of the robot.
    """
    samples, controls = given.num_samples, CONTROLS.get(robot.model, _MOST_CONTROLS) + progress
    # The scan over time keeps one step of the states, and all steps of the controls.
    each = 8.0 * samples * given.horizon * controls + 200.0 * samples * (1.0 + hindrances)
    if given.noise == "bank":
        each += _BANK * samples
    names = f"{section}.num_samples, {section}.horizon"
    return Part("controller", names if not hindrances else f"{names}, obstacles", members * each)


def estimate_record(names: str, steps: float) -> Part:
    """Estimate the memory of what is recorded, which grows with the settings that `names` lists."""
    # What is recorded stands in a file. Metrics and figures hold some of its columns at a time.
    return Part("record", names, 300.0 * steps)
