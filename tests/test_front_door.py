"""What `import jaxplore` gives: few flat names, all others in packages, nothing slow."""

import ast
import importlib
import inspect
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import jaxplore
from jaxplore._renamed import RENAMED

SOURCE = Path(jaxplore.__file__)
MOST_FLAT = 110
SLOW = "scipy matplotlib PIL rich pydantic click gymnasium optuna ray pyarrow optax evosax ribs"
# Flat names of commit 709b5aa, the last with all names flat.
FORMER = """\
Ackermann ActionMode AdaptiveSoftmax AntitheticNoise Augmented AugmentedProposal Average Batch
Belief BestOnly BiasedProposal Camera Candidates ClimbingReference CollisionCost ColouredNoise
ComfortCost Comparison ConditionalValueAtRisk Contextual ContinuousDynamics ContouringCost
ControlCost ControlJerkCost ControlMode ControlNoise ControlRateCost ControlSpace Controller
CorridorCost Cost CovarianceAdaptation CubicSpline DifferentialDrive DifferentialDriveFollower
Direct Disc DiscObstacleCost DiscountedInformation DistanceAdvantage Disturbance Draft Dynamics
Elite Entropic EntropyFan Environment EnvironmentState Euler FUSIONS Faults FeedbackMPPI
FeedbackState FieldNumbers FieldSensor Flight Follower Footprint Fused Fusion GainPerCost
GaussianNoise GaussianProposal GoalCost GradientReference Ground GroundSample GuidanceCost
GuidanceField HaltonNoise HeadingField HomingCost IdealSensor Info InformationCost
InformationField InformativeMPPI InjectedProposal Integrator Interpolation InverseSensorModel
KinematicBicycle Knots LagCost Lidar LinearInterpolation LocalFieldSensor LocalInformationCost
LogNormalNoise Lookout MPPI MPPIState MaternKernel MeanVariance Median Members Metrics Mission
ModelEnsemble Mover MoverState Movers MovingObstacleCost NamedCost NearestFrontier NextBestView
Noise NoiseBank ObstacleCost ObstacleDistanceCost Obstacles OccupancyGrid Outcome Outcomes
Outlines Parameterisation Path PathCost PathErrorCost PathErrors PathFollowing PathMetrics
PathParameter PathPoint PathRecording PathRun PathScenario Pendulum Perception PlannedControl
Planner PointMass Portfolio PortfolioState PoseInformation PoseView PotentialCost ProgressCost
Proposal QuadraticControlCost Quadrotor QuadrotorFollower RBFKernel RK4 ROLES ROLE_WEIGHTS
RandomFrontier RandomWalk RangeNoise Recording Rectangle ReferenceCost RegionCost
RemainingInformation Risk Run SafeFusion SampledPlan SavitzkyGolay ScalarField Scan Scenario
Sensor Shapes Sighting Situation Smooth SmoothNominal SobolNoise Softmax SpeedLimitCost State
StateBoundsCost StateCost StateNoise StrategicBelief StrategicReference StrategyReferenceCost
Summary Surroundings TargetChoice TargetExplorer TargetReference TargetRule TargetScores Targets
TerrainCost TerrainMap TerrainSample ToGoalCost ToeplitzNoise TrackedObstacleCost Tracks Traffic
Trajectory TrajectoryChoice TrajectoryInformation TraversabilityCost TrustWeighted
UncertainObstacles Unicycle UnicycleFollower UniformNoise ValueAtRisk Wander Watch WaypointCost
WaypointMode WeightedVote Weighting WhiteNoise World WorstCase ZeroOrderHold Zones arc_path
augmented_mppi beam_information cauchy_schwarz_information cell_gains cell_information
clearance_field clothoid_path compare diversity entropy_proxy expected_gain explorer extract
find_leaf follow_path follower_for fusion_by_name generate_map goal_mppi ground_portfolio
informative_mppi leaves line_path mpcc office path_headings path_through pose_table race_track
random_walk read_path register_environment rollout rollout_batch rollout_costs rollout_objectives
simulate sin_cos start_pose step_with_gains three_zones unknown_fraction update_gain visible
waypoint_mppi with_leaves
"""


def test_few_names_are_flat_and_all_are_there() -> None:
    assert len(jaxplore.__all__) == len(set(jaxplore.__all__)) <= MOST_FLAT
    for name in jaxplore.__all__:
        assert inspect.isclass(getattr(jaxplore, name)) or callable(getattr(jaxplore, name))
    assert set(jaxplore.__all__) | {"costs", "control", "study"} <= set(dir(jaxplore))


def test_type_checkers_see_what_python_gives() -> None:
    block = next(node for node in ast.parse(SOURCE.read_text()).body if isinstance(node, ast.If))
    seen = {}
    for statement in block.body:
        assert isinstance(statement, ast.ImportFrom)
        for alias in statement.names:
            assert alias.asname == alias.name
            seen[alias.name] = statement.module
    packages = {name for name, module in seen.items() if module == "jaxplore"}
    assert packages == set(jaxplore._PACKAGES)
    assert {name: module for name, module in seen.items() if name not in packages} == {
        name: f"jaxplore.{package}"
        for package, names in jaxplore._PACKAGES.items()
        for name in names
    }


def test_a_flat_name_is_that_of_its_package() -> None:
    for package, names in jaxplore._PACKAGES.items():
        module = importlib.import_module(f"jaxplore.{package}")
        assert getattr(jaxplore, package) is module
        for name in names:
            assert getattr(jaxplore, name) is getattr(module, name)


def run(code: str) -> None:
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_importing_imports_no_other_package_and_a_controller_none_that_is_slow() -> None:
    run(
        "import sys\n"
        "before = {name.partition('.')[0] for name in sys.modules}\n"
        "import jaxplore\n"
        "after = {name.partition('.')[0] for name in sys.modules}\n"
        "added = after - before - set(sys.stdlib_module_names) - {'jaxplore'}\n"
        "assert not added, added\n"
        "assert set(jaxplore.__all__) <= set(dir(jaxplore))\n"
        "import jax, equinox\n"
        "before = {name.partition('.')[0] for name in sys.modules}\n"
        "jaxplore.MPPI, jaxplore.GoalCost, jaxplore.DifferentialDrive, jaxplore.path_through\n"
        "jaxplore.planning\n"
        "after = {name.partition('.')[0] for name in sys.modules}\n"
        f"slow = (after - before) & set({SLOW!r}.split())\n"
        "assert not slow, slow\n"
        "jaxplore.simulate\n"  # can draw frames, which are Pillow's
        "after = {name.partition('.')[0] for name in sys.modules}\n"
        f"slow = (after - before) & set({SLOW!r}.split()) - {{'PIL'}}\n"
        "assert not slow, slow\n"
    )


def test_every_former_name_is_flat_or_has_a_successor_that_exists() -> None:
    former = set(FORMER.split())
    assert len(former) == 262
    assert former == former & set(jaxplore.__all__) | set(RENAMED)
    assert not set(RENAMED) & set(jaxplore.__all__)
    for successor in RENAMED.values():
        assert pkgutil.resolve_name(f"jaxplore.{successor}") is not None


def test_a_former_name_says_where_it_is_now() -> None:
    for former, successor in RENAMED.items():
        with pytest.raises(AttributeError) as caught:
            getattr(jaxplore, former)
        assert str(caught.value) == f"jaxplore.{former} is now jaxplore.{successor}"


def test_a_name_that_there_never_was() -> None:
    with pytest.raises(AttributeError, match=r"^module 'jaxplore' has no attribute 'Teleporter'$"):
        jaxplore.Teleporter  # noqa: B018
