"""Controllers put together for a task."""

from jaxplore.planning.portfolio.actions import fuse_actions as fuse_actions
from jaxplore.planning.portfolio.contextual import ROLES as ROLES
from jaxplore.planning.portfolio.contextual import ContextRule as ContextRule
from jaxplore.planning.portfolio.contextual import Contextual as Contextual
from jaxplore.planning.portfolio.fusion import Candidates as Candidates
from jaxplore.planning.portfolio.fusion import Fused as Fused
from jaxplore.planning.portfolio.fusion import Fusion as Fusion
from jaxplore.planning.portfolio.fusion import Situation as Situation
from jaxplore.planning.portfolio.information_density import (
    InformationDensity as InformationDensity,
)
from jaxplore.planning.portfolio.portfolio import Portfolio as Portfolio
from jaxplore.planning.portfolio.portfolio import PortfolioState as PortfolioState
from jaxplore.planning.portfolio.portfolio import diversity as diversity
from jaxplore.planning.portfolio.safe_fusion import FUSIONS as FUSIONS
from jaxplore.planning.portfolio.safe_fusion import SafeFusion as SafeFusion
from jaxplore.planning.portfolio.safe_fusion import fusion_by_name as fusion_by_name
from jaxplore.planning.portfolio.voting import Average as Average
from jaxplore.planning.portfolio.voting import BestOnly as BestOnly
from jaxplore.planning.portfolio.voting import Median as Median
from jaxplore.planning.portfolio.voting import TrustWeighted as TrustWeighted
from jaxplore.planning.portfolio.voting import WeightedVote as WeightedVote
from jaxplore.planning.presets.explorer import explorer as explorer
from jaxplore.planning.presets.explorer import waypoint_mppi as waypoint_mppi
from jaxplore.planning.presets.flight import FieldNumbers as FieldNumbers
from jaxplore.planning.presets.flight import Flight as Flight
from jaxplore.planning.presets.ground_vehicle import ROLE_WEIGHTS as ROLE_WEIGHTS
from jaxplore.planning.presets.ground_vehicle import Mission as Mission
from jaxplore.planning.presets.ground_vehicle import ground_portfolio as ground_portfolio
from jaxplore.planning.presets.path_following import PathFollowing as PathFollowing
from jaxplore.planning.presets.path_following import augmented_mppi as augmented_mppi
from jaxplore.planning.presets.path_following import avoidance_cost as avoidance_cost
from jaxplore.planning.presets.path_following import mpcc as mpcc
from jaxplore.planning.presets.quadrotor import goal_mppi as goal_mppi
from jaxplore.planning.presets.quadrotor import informative_mppi as informative_mppi
from jaxplore.planning.presets.quadrotor import random_walk as random_walk
from jaxplore.planning.presets.target_explorer import target_explorer as target_explorer
from jaxplore.planning.presets.volume import volume_explorer as volume_explorer
from jaxplore.planning.presets.volume import volume_informative_mppi as volume_informative_mppi
from jaxplore.planning.presets.volume import volume_target_explorer as volume_target_explorer
from jaxplore.planning.strategy.follower import Follower as Follower
from jaxplore.planning.strategy.followers import (
    DifferentialDriveFollower as DifferentialDriveFollower,
)
from jaxplore.planning.strategy.followers import UnicycleFollower as UnicycleFollower
from jaxplore.planning.strategy.followers import follower_for as follower_for
from jaxplore.planning.strategy.gradient_reference import GradientReference as GradientReference
from jaxplore.planning.strategy.informative import InformativeMPPI as InformativeMPPI
from jaxplore.planning.strategy.informative import ShortRangeField as ShortRangeField
from jaxplore.planning.strategy.quadrotor_follower import QuadrotorFollower as QuadrotorFollower
from jaxplore.planning.strategy.random_walk import RandomWalk as RandomWalk
from jaxplore.planning.strategy.references import ClimbingReference as ClimbingReference
from jaxplore.planning.strategy.references import ReferenceStart as ReferenceStart
from jaxplore.planning.strategy.references import StrategicReference as StrategicReference
from jaxplore.planning.strategy.target_choices import RemainingInformation as RemainingInformation
from jaxplore.planning.strategy.target_choices import TrajectoryChoice as TrajectoryChoice
from jaxplore.planning.strategy.target_explorer import TargetExplorer as TargetExplorer
from jaxplore.planning.strategy.target_rules import DiscountedInformation as DiscountedInformation
from jaxplore.planning.strategy.target_rules import DistanceAdvantage as DistanceAdvantage
from jaxplore.planning.strategy.target_rules import GainPerCost as GainPerCost
from jaxplore.planning.strategy.target_rules import NearestCluster as NearestCluster
from jaxplore.planning.strategy.target_rules import NearestFrontier as NearestFrontier
from jaxplore.planning.strategy.target_rules import NextBestView as NextBestView
from jaxplore.planning.strategy.target_rules import RandomFrontier as RandomFrontier
from jaxplore.planning.strategy.target_rules import TargetRule as TargetRule
from jaxplore.planning.strategy.target_rules import Wander as Wander
from jaxplore.planning.strategy.targets import TargetChoice as TargetChoice
from jaxplore.planning.strategy.targets import TargetReference as TargetReference
from jaxplore.planning.strategy.targets import Targets as Targets
from jaxplore.planning.strategy.targets import TargetScores as TargetScores
from jaxplore.planning.strategy.twist_follower import TwistFollower as TwistFollower
from jaxplore.planning.strategy.uncertainty_aware import UncertaintyAware as UncertaintyAware
from jaxplore.planning.strategy.volume_approach import GoalApproach as GoalApproach
from jaxplore.planning.strategy.volume_informative import (
    VolumeInformativeMPPI as VolumeInformativeMPPI,
)
from jaxplore.planning.strategy.volume_reference import VolumeReference as VolumeReference
from jaxplore.planning.strategy.volume_targets import VolumeTargetExplorer as VolumeTargetExplorer
