"""What is kept of a run, as NumPy arrays on the host."""

import dataclasses

import numpy as np

from jaxplore.simulation.exploration.record import Record


@dataclasses.dataclass(frozen=True)
class Frame:
    """One look at a run, for drawing.

    Args:
        step: how many steps were done.
        time: since the start [s].
        state: (nx,) the robot.
        probability: (H, W) the belief in 256 levels, 0 free to 255 occupied.
        information: (rows, columns) information of a scan at the nodes of the field [nat].
        scan: (B, 2) world points where the beams end [m].
        samples: (N, T + 1, 2) positions of some rollouts [m].
        weights: (N,) their weights.
        plan: (T + 1, 2) positions along the nominal [m].
        heading: of the robot [rad].
        reference: (R, 2) positions that the plan is to follow [m]; empty if there are none.
        movers: (M, 2) where what moves is [m].
        terms: what the nominal pays for each term of the cost.
    """

    step: int
    time: float
    state: np.ndarray
    probability: np.ndarray
    information: np.ndarray
    scan: np.ndarray
    samples: np.ndarray
    weights: np.ndarray
    plan: np.ndarray
    heading: float
    reference: np.ndarray
    movers: np.ndarray
    terms: dict[str, float]


@dataclasses.dataclass(frozen=True)
class Timing:
    """Wall-clock times.

    Args:
        compile_seconds: until the loop is ready for its first step; near 0 if it was compiled
            before.
        loop_seconds: spent in the loop's chunks, compilation apart.
        loop_steps: steps done in them.
        step_seconds: (N,) of single steps that were timed one at a time, spread over the run.
    """

    compile_seconds: float
    loop_seconds: float
    loop_steps: int
    step_seconds: np.ndarray


@dataclasses.dataclass(frozen=True)
class Recording:
    """A run: every step, some looks at it, and what is needed to judge and draw it.

    Args:
        records: `Record` with a leading axis of steps.
        frames: looks at the run, evenly spread, the last one at its end.
        timing: wall-clock times.
        control_period: [s].
        world: (H, W) probability of the true map.
        belief: (H, W) probability of the robot's map at the end.
        reachable: (H, W) cells that count for coverage.
        origin: pose of the grid [m, m, rad].
        resolution: side of a cell [m].
        field_origin: pose of the lattice of the information field [m, m, rad].
        field_resolution: distance between its nodes [m].
        start: (nx,) state at the start.
        initial_coverage: before the first step.
        initial_entropy: of the belief over the reachable cells before the first step [nat].
        initial_unknown: share of unknown cells before the first step.
        goal: (2,) where to be in the end [m]; None if there is no goal.
        finished_step: steps done when the scenario was finished; None if it was not, or before the
            first step.
        control_half_range: (nu,) half the range between the bounds of each control.
        state_names: of the robot's state.
        robot_radius: [m].
        target_coverage: at which exploration is finished; None if it never is.
        is_interrupted: the user stopped the run; what is here was done before.
        footprint: (4, 2) corners of a robot that is a rectangle, in its own frame [m]; (0, 2) of a
            disc.
        targets: (M, 2) what was to be seen [m].
        elevation: (H, W) of the ground [m]; None if it is level.
        traversable: (H, W) cells of the ground that may be entered; None if it is level.
        idleness: (H, W) time since each cell was seen, at the end [s]; None if nobody keeps watch.
        mover_radii: (M,) of what moves [m].
        member_names: of a controller that holds several.
    """

    records: Record
    frames: tuple[Frame, ...]
    timing: Timing
    control_period: float
    world: np.ndarray
    belief: np.ndarray
    reachable: np.ndarray
    origin: np.ndarray
    resolution: float
    field_origin: np.ndarray
    field_resolution: float
    start: np.ndarray
    initial_coverage: float
    initial_entropy: float
    initial_unknown: float
    goal: np.ndarray | None
    finished_step: int | None
    control_half_range: np.ndarray
    state_names: tuple[str, ...]
    robot_radius: float
    target_coverage: float | None
    is_interrupted: bool
    footprint: np.ndarray
    targets: np.ndarray
    elevation: np.ndarray | None
    traversable: np.ndarray | None
    idleness: np.ndarray | None
    mover_radii: np.ndarray
    member_names: tuple[str, ...]

    @property
    def num_steps(self) -> int:
        """How many steps were done."""
        return len(self.records.coverage)

    @property
    def positions(self) -> np.ndarray:
        """(N + 1, 2) positions of the robot, the start included [m]."""
        states = np.concatenate([self.start[None], self.records.state])
        return states[:, [self.state_names.index("x"), self.state_names.index("y")]]
