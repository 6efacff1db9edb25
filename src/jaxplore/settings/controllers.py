"""Sections of the controllers that explore: MPPI, portfolios and informative MPPI."""

from typing import Annotated, Literal

from pydantic import Field

from jaxplore._limits import MOST_MEMBERS, MOST_NAMES
from jaxplore.planning.portfolio.contextual import Contextual
from jaxplore.planning.portfolio.safe_fusion import SafeFusion
from jaxplore.planning.portfolio.voting import WeightedVote
from jaxplore.planning.presets.explorer import explorer
from jaxplore.planning.presets.flight import FieldNumbers, Flight
from jaxplore.planning.presets.ground_vehicle import ground_portfolio
from jaxplore.planning.presets.path_following import mpcc
from jaxplore.planning.presets.quadrotor import informative_mppi, zone_choice
from jaxplore.settings.architectures import EXPLORING, FLYING, FUSING, INFORMED
from jaxplore.settings.defaults import setting
from jaxplore.settings.readers import architectures
from jaxplore.settings.sections import (
    Body,
    Fraction,
    Headings,
    Margin,
    NoiseName,
    NonNegative,
    ParameterisationName,
    Positive,
    Range,
    Samples,
    Section,
    Share,
    Spacing,
    Step,
    StepsAhead,
    WeightingName,
)

Deviations = Annotated[tuple[Positive, ...], Field(max_length=MOST_NAMES)]
Weights = Annotated[dict[str, NonNegative], Field(max_length=MOST_NAMES)]


BY_MEMBERS = FUSING.narrow("no portfolio.weights", lambda given: given.portfolio.weights is None)
SAFE = FUSING.narrow("portfolio.is_safe", lambda given: given.portfolio.is_safe)
VOTING, CONTEXTUAL = (
    FUSING.narrow(
        f"portfolio.fusion {fusion}",
        lambda given, fusion=fusion: given.portfolio.fusion == fusion,  # type: ignore[misc]
    )
    for fusion in ("weighted-vote", "contextual")
)
SEQUENTIAL = architectures("sequential")


class ControllerSettings(Section):
    """MPPI and its costs: see `jaxplore.explorer`."""

    readers = EXPLORING

    parameterisation: ParameterisationName = setting(explorer, "parameterisation")
    horizon: StepsAhead = setting(explorer, "horizon")
    num_samples: Samples = setting(explorer, "num_samples")
    noise: NoiseName = setting(explorer, "noise")
    weighting: WeightingName = setting(explorer, "weighting")
    temperature: Positive = setting(explorer, "temperature")
    effective_share: Share = setting(explorer, "effective_share")
    noise_std: Deviations | None = setting(explorer, "noise_std")
    dt: Step = setting(explorer, "dt")
    clearance: Body = setting(explorer, "clearance")
    obstacle_weight: NonNegative = setting(explorer, "obstacle_weight")
    information_weight: NonNegative = setting(explorer, "information_weight")
    guidance_weight: NonNegative = setting(explorer, "guidance_weight")
    control_weight: NonNegative = setting(explorer, "control_weight")


class PortfolioSettings(Section):
    """A portfolio for a ground vehicle and its fusion: see `jaxplore.ground_portfolio`.

    Args:
        members: names of members of the decomposition; all when absent.
        weights: weights by member and objective, in place of `members`.
        fusion: rule that fuses the members' plans.
        is_safe: whether the fusion is wrapped in a `SafeFusion`.
    """

    readers = FUSING

    decomposition: Literal["roles", "temporal", "regional"] = setting(
        ground_portfolio, "decomposition"
    )
    members: Annotated[
        Annotated[tuple[str, ...], Field(max_length=MOST_MEMBERS)] | None, BY_MEMBERS
    ] = None
    weights: Annotated[dict[str, Weights], Field(max_length=MOST_MEMBERS)] | None = None
    common: Weights | None = setting(ground_portfolio, "common")
    fusion: Literal[
        "weighted-vote",
        "best-only",
        "average",
        "median",
        "trust-weighted",
        "information-density",
        "contextual",
    ] = "weighted-vote"
    roles: Annotated[
        Annotated[dict[str, str], Field(max_length=MOST_MEMBERS)] | None, CONTEXTUAL
    ] = setting(Contextual, "roles")
    is_safe: bool = True
    regret: Annotated[NonNegative | None, SAFE] = setting(SafeFusion, "regret")
    vote_temperature: Annotated[Positive, VOTING] = setting(WeightedVote, "temperature")
    near_goal: Annotated[Positive, CONTEXTUAL] = setting(Contextual, "near_goal")
    near_obstacle: Annotated[Positive, CONTEXTUAL] = setting(Contextual, "near_obstacle")
    rich_information: Annotated[Positive, CONTEXTUAL] = setting(Contextual, "rich_information")
    hysteresis: Annotated[NonNegative, CONTEXTUAL] = setting(Contextual, "hysteresis")
    parameterisation: ParameterisationName = setting(ground_portfolio, "parameterisation")
    effort: NonNegative = setting(ground_portfolio, "effort")
    horizon: StepsAhead = setting(ground_portfolio, "horizon")
    num_samples: Samples = setting(ground_portfolio, "num_samples")
    noise: NoiseName = setting(ground_portfolio, "noise")
    weighting: WeightingName = setting(ground_portfolio, "weighting")
    temperature: Positive = setting(ground_portfolio, "temperature")
    effective_share: Share = setting(ground_portfolio, "effective_share")
    noise_share: Positive = setting(ground_portfolio, "noise_share")
    dt: Step = setting(ground_portfolio, "dt")
    clearance: Body = setting(ground_portfolio, "clearance")
    margin: Margin = setting(ground_portfolio, "margin")


class InformativeSettings(Section):
    """Informative MPPI: see `jaxplore.informative_mppi`, `jaxplore.Flight` and
    `jaxplore.FieldNumbers`."""

    readers = INFORMED

    parameterisation: Annotated[ParameterisationName, FLYING] = setting(Flight, "parameterisation")
    horizon: Annotated[StepsAhead, FLYING] = setting(Flight, "horizon")
    num_samples: Annotated[Samples, FLYING] = setting(Flight, "num_samples")
    noise: Annotated[NoiseName, FLYING] = setting(Flight, "noise")
    weighting: Annotated[WeightingName | None, FLYING] = setting(Flight, "weighting")
    temperature: Annotated[Positive, FLYING] = setting(Flight, "temperature")
    effective_share: Annotated[Share, FLYING] = setting(Flight, "effective_share")
    noise_std: Annotated[Deviations | None, FLYING] = setting(Flight, "noise_std")
    dt: Annotated[Step, FLYING] = setting(Flight, "dt")
    clearance: Annotated[Body, FLYING] = setting(Flight, "clearance")
    bias_fraction: Fraction = setting(informative_mppi, "bias_fraction")
    likelihood_ratio: bool = setting(informative_mppi, "likelihood_ratio")
    field_beams: Headings = setting(FieldNumbers, "field_beams")
    field_range: Range = setting(FieldNumbers, "field_range")
    field_noise: NonNegative = setting(FieldNumbers, "field_noise")
    field_spacing: Spacing = setting(FieldNumbers, "field_spacing")
    field_extent: Range = setting(FieldNumbers, "field_extent")
    field_headings: Headings = setting(FieldNumbers, "field_headings")
    local_beams: Headings = setting(FieldNumbers, "local_beams")
    local_range: Range = setting(FieldNumbers, "local_range")
    local_extent: Range = setting(FieldNumbers, "local_extent")
    by_heading: bool = setting(informative_mppi, "by_heading")
    reference_speed: Positive = setting(informative_mppi, "reference_speed")
    reference_steps: StepsAhead = setting(informative_mppi, "reference_steps")
    target_choice: Annotated[
        Literal["remaining", "direct", "discount", "filtered", "temporal", "occlusion"], SEQUENTIAL
    ] = setting(zone_choice, "method")
    distance_weight: Annotated[NonNegative | None, SEQUENTIAL] = setting(
        zone_choice, "distance_weight"
    )
    depleted: Annotated[Share, SEQUENTIAL] = setting(zone_choice, "depleted")
    goal_when_explored: bool = setting(informative_mppi, "goal_when_explored")
    reference_weight: NonNegative = setting(informative_mppi, "reference_weight")
    local_weight: NonNegative = setting(informative_mppi, "local_weight")
    field_weight: NonNegative = setting(informative_mppi, "field_weight")
    guidance_weight: NonNegative = setting(informative_mppi, "guidance_weight")
    goal_weight: NonNegative = setting(informative_mppi, "goal_weight")
    obstacle_weight: Annotated[NonNegative, FLYING] = setting(Flight, "obstacle_weight")
    height_weight: Annotated[NonNegative, FLYING] = setting(Flight, "height_weight")
    speed_weight: Annotated[NonNegative, FLYING] = setting(Flight, "speed_weight")
    control_weight: Annotated[NonNegative, FLYING] = setting(Flight, "control_weight")


class ContouringNumbers(Section):
    """Contouring control along any path: see `jaxplore.mpcc`."""

    parameterisation: ParameterisationName = setting(mpcc, "parameterisation")
    noise: Literal["gaussian", "coloured"] = setting(mpcc, "noise")
    weighting: WeightingName = setting(mpcc, "weighting")
    effective_share: Share = setting(mpcc, "effective_share")
    horizon: StepsAhead = setting(mpcc, "horizon")
    num_samples: Samples = setting(mpcc, "num_samples")
    dt: Step = setting(mpcc, "dt")
    temperature: Positive = setting(mpcc, "temperature")
    contouring_weight: NonNegative = setting(mpcc, "contouring_weight")
    lag_weight: NonNegative = setting(mpcc, "lag_weight")
    progress_weight: NonNegative = setting(mpcc, "progress_weight")
    noise_share: Positive = setting(mpcc, "noise_share")
    progress_noise: Positive = setting(mpcc, "progress_noise")
    max_lateral: Positive = setting(mpcc, "max_lateral")
    max_longitudinal: Positive = setting(mpcc, "max_longitudinal")
    comfort_weight: NonNegative = setting(mpcc, "comfort_weight")
