"""Path following in one call: contouring control with MPPI."""

from typing import NamedTuple

from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import Vector
from jaxplore.compat.planner import Planner
from jaxplore.control.augmented import AugmentedProposal
from jaxplore.control.disturbance import Disturbance
from jaxplore.control.knots import Knots
from jaxplore.control.mppi import MPPI
from jaxplore.control.parameterisations import Parameterisation
from jaxplore.control.proposals import GaussianProposal, Proposal
from jaxplore.control.risk import Risk
from jaxplore.control.weighting import Softmax
from jaxplore.costs.base import Cost
from jaxplore.costs.path_following import ContouringCost, CorridorCost, LagCost, ProgressCost
from jaxplore.dynamics.augmented import Augmented
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.path_parameter import PathParameter
from jaxplore.geometry.path import Path

KNOTS = 5
"""Knots of the control splines: smooth noise turns a car, white noise shakes it."""


class PathFollowing(NamedTuple):
    """A contouring controller and the costs that measure its errors.

    Args:
        planner: planner, see `Planner`; `planner.mppi` is its `Controller`.
        model: model of the robot and of its progress along the path.
        contouring: cost that measures the error across the path.
        lag: cost that measures the error along the path.
    """

    planner: Planner
    model: Augmented
    contouring: ContouringCost
    lag: LagCost


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
    disturbance: Disturbance | None = None,
    num_outcomes: int = 1,
    risk: Risk | None = None,
) -> Planner:
    """Build a planner for a robot whose state is extended by a virtual part.

    Args:
        physical: the robot.
        virtual: what is planned beside it.
        cost: what to minimise, over states of `Augmented(physical, virtual)`.
        physical_proposal: of the robot's controls.
        virtual_proposal: of the virtual ones; its random stream is its own.
        horizon: model steps ahead, T.
        num_samples: rollouts, M.
        temperature: of the softmax where a step gives none [units of cost].
        dt: model step [s].
        parameterisation: of the controls; the controls themselves when absent.
        disturbance: what outcomes are uncertain by, such as `UncertainObstacles`; none when absent.
        num_outcomes: of each control sequence, if there is a disturbance.
        risk: how the outcomes' costs become one; their mean when absent.

    Raises:
        ValueError: parts that do not fit, and what `MPPI` refuses.
    """
    model = Augmented(physical, virtual)
    return Planner(
        MPPI(
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
            weighting=Softmax(temperature, importance=0.0),
        )
    )


def mpcc(
    robot: Dynamics,
    path: Path,
    *,
    noise_std: Vector,
    max_speed: ArrayLike,
    progress_noise: ArrayLike = 0.5,
    contouring_weight: ArrayLike = 100.0,
    lag_weight: ArrayLike = 100.0,
    progress_weight: ArrayLike = 600.0,
    other: Cost | None = None,
    corridor: bool | None = None,
    corridor_margin: ArrayLike = 0.05,
    horizon: int = 30,
    num_samples: int = 256,
    temperature: ArrayLike = 50.0,
    dt: ArrayLike = 0.1,
    parameterisation: Parameterisation | None = None,
    disturbance: Disturbance | None = None,
    num_outcomes: int = 1,
    risk: Risk | None = None,
) -> PathFollowing:
    """Return model predictive contouring control of a robot along a path.

        J = sum over t of w_c e_c^2 + w_l e_l^2 - w_p dt phi_rate + corridor + other

    Args:
        robot: its model.
        path: to follow.
        noise_std: (nu,) of the robot's controls.
        max_speed: bound of the progress along the path [m/s].
        progress_noise: standard deviation of its noise [m/s].
        contouring_weight: w_c [1/m^2].
        lag_weight: w_l [1/m^2].
        progress_weight: w_p, gained by each metre of the path [1/m].
        other: costs of one's own, such as of obstacles.
        corridor: whether to keep within the path's half widths; if it has them, when absent.
        corridor_margin: kept from their edges [m].
        horizon: model steps ahead, T.
        num_samples: rollouts, M.
        temperature: of the softmax where a step gives none [units of cost].
        dt: model step [s].
        parameterisation: of the controls; splines through 5 knots when absent.
        disturbance: what outcomes are uncertain by, such as `UncertainObstacles`; none when absent.
        num_outcomes: of each control sequence, if there is a disturbance.
        risk: how the outcomes' costs become one; their mean when absent.

    Raises:
        ValueError: a path without half widths beside `corridor`, one that is narrower than the
            robot, negative weights, and what the parts refuse.
    """
    contouring, lag = ContouringCost(path), LagCost(path)
    step = _checks.scalar("dt", dt, above=0.0)
    gain = _checks.scalar("progress_weight", progress_weight, at_least=0.0)
    total: Cost = _checks.scalar("contouring_weight", contouring_weight, at_least=0.0) * contouring
    total = total + _checks.scalar("lag_weight", lag_weight, at_least=0.0) * lag
    total = total + (gain * step) * ProgressCost()
    if path.has_room if corridor is None else corridor:
        keep = CorridorCost(path, margin=corridor_margin)
        keep.check(robot)
        total = total + 100.0 * keep
    if other is not None:
        total = total + other
    if parameterisation is None:
        parameterisation = Knots(min(KNOTS, _checks.positive_int("horizon", horizon)))
    planner = augmented_mppi(
        robot,
        PathParameter.along(path, max_speed),
        total,
        physical_proposal=GaussianProposal(noise_std),
        virtual_proposal=GaussianProposal(
            _checks.scalar("progress_noise", progress_noise, above=0.0)[None]
        ),
        horizon=horizon,
        num_samples=num_samples,
        temperature=temperature,
        dt=step,
        parameterisation=parameterisation,
        disturbance=disturbance,
        num_outcomes=num_outcomes,
        risk=risk,
    )
    model = planner.mppi.dynamics
    assert isinstance(model, Augmented)
    return PathFollowing(planner, model, contouring, lag)
