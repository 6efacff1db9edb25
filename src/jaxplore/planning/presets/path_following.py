"""Model predictive contouring control with MPPI in one call."""

from typing import NamedTuple

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_OUTCOMES
from jaxplore._types import ArrayLike, Vector
from jaxplore.control.augmented import AugmentedProposal
from jaxplore.control.disturbance import Disturbance
from jaxplore.control.mppi import MPPI
from jaxplore.control.parameterisations import Parameterisation
from jaxplore.control.proposals import GaussianProposal, Proposal
from jaxplore.control.risk import Risk
from jaxplore.control.weighting import Weighting
from jaxplore.costs.base import Cost
from jaxplore.costs.comfort import ComfortCost
from jaxplore.costs.moving import MovingObstacleCost
from jaxplore.costs.path_following import (
    ContouringCost,
    CorridorCost,
    LagCost,
    ProgressCost,
    StopCost,
)
from jaxplore.dynamics._bounds import bound_of_speed
from jaxplore.dynamics.augmented import Augmented
from jaxplore.dynamics.base import ContinuousDynamics, Dynamics
from jaxplore.dynamics.path_parameter import PathParameter
from jaxplore.geometry.path import Path
from jaxplore.planning.presets.sampling import (
    noise_by_name,
    parameterisation_by_name,
    spread,
    weighting_by_name,
)

KNOTS = 5
"""Number of knots of the control splines. Smooth noise turns a car; white noise averages out."""
NOISES = ("gaussian", "coloured")
"""Sources of noise that two parts may draw from apart."""


class PathFollowing(NamedTuple):
    """A path-following controller with its model and the cost terms that measure its errors.

    Args:
        controller: MPPI over the robot's controls and its progress along the path.
        model: model of the robot and its progress along the path.
        contouring: contouring cost of the controller, which also measures recorded states.
        lag: the lag cost of the controller, which also measures recorded states.
    """

    controller: MPPI
    model: Augmented
    contouring: ContouringCost
    lag: LagCost


@_kinds.check_arguments
def augmented_mppi(
    physical: Dynamics,
    virtual: Dynamics,
    cost: Cost,
    *,
    physical_proposal: Proposal,
    virtual_proposal: Proposal,
    horizon: int = 30,
    num_samples: int = 256,
    temperature: ArrayLike = 50.0,
    dt: ArrayLike = 0.1,
    parameterisation: Parameterisation | None = None,
    weighting: Weighting | str = "softmax",
    effective_share: ArrayLike = 0.05,
    disturbance: Disturbance | None = None,
    num_outcomes: int = 1,
    risk: Risk | None = None,
) -> MPPI:
    """Build MPPI for a robot whose state is augmented by virtual states.

    Its `dynamics` are `Augmented(physical, virtual)`.

    Args:
        physical: model of the robot.
        virtual: model of the virtual states, which are planned together with the robot's.
        cost: cost of states of `Augmented(physical, virtual)`.
        physical_proposal: proposal distribution of the robot's controls.
        virtual_proposal: proposal distribution of the virtual controls, with its own random stream.
        horizon: model steps ahead, T.
        num_samples: rollouts, K.
        temperature: temperature of the softmax; the least one of the adaptive softmax [units of
            cost].
        dt: model step [s].
        parameterisation: parameterisation of the controls; direct when absent.
        weighting: weighting of the rollouts, or its name: softmax, adaptive or elite.
        effective_share: share of the samples that count: the least one of the adaptive softmax,
            that of the elite.
        disturbance: source of uncertainty of a plan's cost, such as `UncertainObstacles`; none when
            absent.
        num_outcomes: sampled outcomes of each control sequence, if there is a disturbance.
        risk: risk measure over the costs of the outcomes; their mean when absent.

    Raises:
        ValueError: parts that do not fit together, or a value that `MPPI` rejects.
    """
    model = Augmented(physical, virtual)
    return MPPI(
        model,
        cost,
        horizon=horizon,
        num_samples=num_samples,
        dt=dt,
        proposal=AugmentedProposal(model, physical_proposal, virtual_proposal),
        parameterisation=parameterisation,
        disturbance=disturbance,
        num_outcomes=num_outcomes,
        risk=risk,
        # No likelihood ratio: it would draw the plan towards the default control.
        weighting=weighting_by_name(
            weighting,
            temperature=temperature,
            effective_share=effective_share,
            num_samples=num_samples,
        ),
    )


def avoidance_cost(
    weight: ArrayLike = 100.0,
    clearance: ArrayLike = 0.5,
    margin: ArrayLike = 0.05,
    caution: ArrayLike = 1.0,
) -> Cost:
    """Build the obstacle cost along a path, for `mpcc(..., other=avoidance_cost())`.

        weight * MovingObstacleCost(clearance, collision=1, margin, caution) of the nearest obstacle

    Args:
        weight: cost of a step that is 5 cm too close.
        clearance: distance of the robot's centre from an obstacle below which the cost is positive
            [m].
        margin: distance kept beyond the robot's radius [m].
        caution: number of standard deviations of an obstacle's position to keep clear of.

    Raises:
        ValueError: a clearance that is not positive, another value that is negative.
    """
    return _checks.scalar("weight", weight, at_least=0.0) * MovingObstacleCost(
        nearness=None,
        clearance=clearance,
        collision=1.0,
        margin=margin,
        caution=caution,
        nearest_only=True,
    )


@_kinds.check_arguments
def mpcc(
    robot: Dynamics,
    path: Path,
    *,
    noise_share: ArrayLike = 0.2,
    noise_std: Vector | None = None,
    progress_noise: ArrayLike = 0.5,
    max_speed: ArrayLike | None = None,
    contouring_weight: ArrayLike = 10.0,
    lag_weight: ArrayLike = 50.0,
    progress_weight: ArrayLike = 500.0,
    comfort_weight: ArrayLike | None = 20.0,
    max_lateral: ArrayLike = 7.0,
    max_longitudinal: ArrayLike = 7.0,
    other: Cost | None = None,
    corridor: bool | None = None,
    corridor_margin: ArrayLike = 0.05,
    end_heading: ArrayLike | None = None,
    horizon: int = 30,
    num_samples: int = 512,
    temperature: ArrayLike = 30.0,
    dt: ArrayLike = 0.05,
    parameterisation: Parameterisation | str = "knots",
    noise: str = "gaussian",
    weighting: Weighting | str = "softmax",
    effective_share: ArrayLike = 0.05,
    disturbance: Disturbance | None = None,
    num_outcomes: int = 16,
    risk: Risk | None = None,
) -> PathFollowing:
    """Build model predictive contouring control (MPCC) of a robot along a path.

        J = sum over t of w_c e_c^2 + w_l e_l^2 - w_p dt phi_rate
                          + w_a [(|a_lat| - max_lateral)_+^2 + (|a_lon| - max_longitudinal)_+^2]
                          + w_p dt stop + corridor + other

    On an open path the robot comes to rest at the end and in cusps (`StopCost`).

    The defaults are those of `jaxplore run path`: a car of F1TENTH's size on a track. Where there
    are obstacles, `other` is `avoidance_cost()`.

    The function has more than 60 lines because it is the one place of these numbers.

    Args:
        robot: model of the robot.
        path: path to follow.
        noise_share: standard deviation of the robot's controls at 5 knots, as a share of half
            their range; with another parameterisation such that their sum has the same spread.
        noise_std: (nu,) standard deviations in units of the controls, instead of `noise_share`.
        progress_noise: standard deviation of the progress, likewise [m/s].
        max_speed: bound of the progress along the path [m/s]; when absent the robot's `max_speed`,
            or the bound of its control `v`.
        contouring_weight: weight of the contouring error, w_c [1/m^2].
        lag_weight: weight of the lag error, w_l [1/m^2].
        progress_weight: reward of each metre along the path, w_p [1/m].
        comfort_weight: weight of accelerations beyond the free ones, w_a, see `ComfortCost`
            [s^4/m^2]; None for no such cost, which a model without a time derivative requires.
        max_lateral: free acceleration across the heading, such as what the tyres hold [m/s^2].
        max_longitudinal: free acceleration along the heading [m/s^2].
        other: further costs, such as `avoidance_cost()`.
        corridor: whether to keep within the path's half widths; when absent, if the path has them.
        corridor_margin: distance kept from the corridor's edges [m].
        end_heading: heading at the end of an open path [rad]; any when absent.
        horizon: model steps ahead, T.
        num_samples: rollouts, K.
        temperature: temperature of the softmax; the least one of the adaptive softmax [units of
            cost].
        dt: model step [s].
        parameterisation: parameterisation of the controls, or its name: direct, smooth or knots
            (splines through 5 knots).
        noise: name of the source of noise: gaussian or coloured (pink). The robot and its progress
            are drawn apart, and of sobol or bank they would draw the same points.
        weighting: weighting of the rollouts, or its name: softmax, adaptive or elite.
        effective_share: share of the samples that count: the least one of the adaptive softmax,
            that of the elite.
        disturbance: source of uncertainty of a plan's cost, such as `UncertainObstacles`; none when
            absent.
        num_outcomes: outcomes of each control sequence, if there is a disturbance.
        risk: risk measure over the costs of the outcomes; their mean when absent.

    Raises:
        ValueError: a corridor for a path without half widths, a path that is narrower than the
            robot, negative weights, a robot without a `max_speed` if none is given, a heading at
            the end of a closed path, a `comfort_weight` for a robot without a time derivative, or a
            value that a part rejects.
    """
    _checks.scalar("corridor_margin", corridor_margin, at_least=0.0)
    _checks.positive_int("num_outcomes", num_outcomes, at_most=MOST_OUTCOMES)
    _kinds.instance("noise", noise, str)
    if corridor is not None:
        _kinds.flag("corridor", corridor)
    _checks.scalar("max_lateral", max_lateral, at_least=0.0)
    _checks.scalar("max_longitudinal", max_longitudinal, at_least=0.0)
    if max_speed is not None:
        _checks.scalar("max_speed", max_speed, above=0.0)
    if end_heading is not None:
        _checks.scalar("end_heading", end_heading)
        if path.is_closed:
            raise ValueError(
                f"end_heading is {end_heading!r} for a closed path; accepted: None, it has no end"
            )
    contouring, lag = ContouringCost(path), LagCost(path)
    step = _checks.scalar("dt", dt, above=0.0)
    gain = _checks.scalar("progress_weight", progress_weight, at_least=0.0)
    total: Cost = _checks.scalar("contouring_weight", contouring_weight, at_least=0.0) * contouring
    total = total + _checks.scalar("lag_weight", lag_weight, at_least=0.0) * lag
    # The progress is a rate. Times the step, its sum is the distance along the path in metres.
    total = total + (gain * step) * ProgressCost()
    if not path.is_closed:
        # A car drives backwards if it can; a robot that turns on the spot does so.
        reverses = robot.can_reverse and bool(robot.turning_radius > 0.0)
        total = total + (gain * step) * StopCost(path, not reverses, end_heading)
    if path.has_room if corridor is None else corridor:
        keep = CorridorCost(path, margin=corridor_margin)
        keep.check(robot)
        total = total + 100.0 * keep
    if comfort_weight is not None:
        comfort = _comfort(robot, comfort_weight, max_lateral, max_longitudinal)
        other = comfort if other is None else comfort + other
    if other is not None:
        total = total + other
    chosen = parameterisation_by_name(parameterisation, horizon, KNOTS)
    usual = parameterisation_by_name("knots", horizon, KNOTS)
    factor = spread(chosen, horizon, step) / spread(usual, horizon, step)
    if noise_std is None:
        half_range = robot.control_half_range
        noise_std = _checks.scalar("noise_share", noise_share, above=0.0) * half_range
    progress = PathParameter.along(path, _bound(robot) if max_speed is None else max_speed)
    progress_std = _checks.scalar("progress_noise", progress_noise, above=0.0)[None]

    def proposal(std: Vector) -> GaussianProposal:
        # Checks the standard deviations, which are scaled afterwards.
        given = GaussianProposal(std).noise_std
        assert given is not None
        drawn = noise_by_name(noise, num_samples, NOISES)
        return GaussianProposal(factor * given, noise=drawn)

    controller = augmented_mppi(
        robot,
        progress,
        total,
        physical_proposal=proposal(noise_std),
        virtual_proposal=proposal(progress_std),
        horizon=horizon,
        num_samples=num_samples,
        temperature=temperature,
        dt=step,
        parameterisation=chosen,
        weighting=weighting,
        effective_share=effective_share,
        disturbance=disturbance,
        num_outcomes=1 if disturbance is None else num_outcomes,
        risk=risk,
    )
    model = controller.dynamics
    assert isinstance(model, Augmented)
    return PathFollowing(controller, model, contouring, lag)


def _comfort(
    robot: Dynamics, weight: ArrayLike, max_lateral: ArrayLike, max_longitudinal: ArrayLike
) -> Cost:
    if not isinstance(robot, ContinuousDynamics):
        raise ValueError(
            f"comfort_weight is {weight!r} for {type(robot).__name__}, which has no time "
            "derivative; accepted: None"
        )
    return _checks.scalar("comfort_weight", weight, at_least=0.0) * ComfortCost(
        lateral=1.0,
        longitudinal=1.0,
        free_lateral=max_lateral,
        free_longitudinal=max_longitudinal,
    )


def _bound(robot: Dynamics) -> ArrayLike:
    speed = bound_of_speed(robot)
    if speed is None:
        raise ValueError(
            f"max_speed is None for {type(robot).__name__}, which has none of its own; accepted: "
            "a speed [m/s]"
        )
    return speed
