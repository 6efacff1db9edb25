"""Why a parameter of nav2's MPPI controller has no counterpart among the settings."""

FORWARDS = "differential_drive only drives forwards; robot.model unicycle drives backwards too"
LATERAL = "robot.max_acceleration and robot.max_deceleration bound both directions"
NOT_LATERAL = "this robot does not drive sideways"
NOT_A_CAR = "only a car has a turning circle"
STEERED = "a car's turn rate follows from its speed and robot.max_steering"
CAR_NOISE = "samples of a car are accelerations and steering rates, with half their range as noise"
PATH_NOISE = "samples are splines of accelerations; their noise is controller.noise_share"
TEMPERATURE = "contouring has other units of cost; its default controller.temperature is kept"
POWER = "costs have a fixed growth"
NOT_LISTED = "it is not among critics, so nav2 does not read it"
OTHER = (
    "it is another controller than MPPI: its robot and rates are taken, and jaxplore's own drives"
)
DISABLED = "the critic is disabled"

_TRACKING = "the robot follows the guidance field of its map, not a global path"
_NEAR_GOAL = "costs do not change near the goal or along the path"
_SHOWN = "monitors and the animation of a run show rollouts"
_HANDED = "the whole path is known to the controller, which does not prune or transform it"
_SHIM = "a robot that can turn on the spot does so where its path or guidance asks for it"
_KEPT = "a step without a finite rollout keeps the shifted plan"

_CRITICS = {
    "ConstraintCritic": "the bounds of the model always hold",
    "GoalCritic": "the guidance field ends at the goal",
    "GoalAngleCritic": "settings have no goal heading; in Python costs.WaypointCost(heading=...), "
    "with is_symmetric=True for symmetric_yaw_tolerance",
    "PreferForwardCritic": "settings have no such cost; in Python costs.BackwardsCost(), for a "
    "robot that can drive backwards",
    "TwirlingCritic": "controller.control_weight prices turning; in Python "
    "StateCost({'omega': weight})",
    "VelocityDeadbandCritic": "models have no deadband of velocities",
    "PathAlignCritic": _TRACKING,
    "PathAlignLegacyCritic": _TRACKING,
    "PathAngleCritic": _TRACKING,
}
_CRITICS_ALONG_A_PATH = {
    "GoalCritic": "progress along the path is rewarded up to its end",
    "PathAngleCritic": "contouring and lag errors imply the heading",
    "TwirlingCritic": "controller.comfort_weight prices lateral accelerations",
}
_PARAMETERS = {
    "iteration_count": "a step samples and averages once; controller.num_samples is the means",
    "gamma": "controls are priced by controller.control_weight and the softmax's own importance",
    "regenerate_noises": "noise is drawn anew in every step",
    "retry_attempt_limit": _KEPT,
    "reset_period": _KEPT,
    "visualize": _SHOWN,
    "TrajectoryVisualizer": _SHOWN,
    "publish_optimal_trajectory": _SHOWN,
    "publish_critics_stats": _SHOWN,
    "prune_distance": _HANDED,
    "transform_tolerance": _HANDED,
    "max_robot_pose_search_dist": _HANDED,
    "enforce_path_inversion": _HANDED,
    "inversion_xy_tolerance": _HANDED,
    "inversion_yaw_tolerance": _HANDED,
    "open_loop": "the state is observed in every step",
    "sgf_order": "settings have no smoothing filter; in Python MPPI(smoothing=SavitzkyGolay(...))",
    "TrajectoryValidator": "collisions are counted, and a rollout that collides costs more",
    "cost_weight": "the weight is another parameter of this critic",
    "critical_weight": "contact has a fixed growth, see costs.ObstacleCost",
    "critical_cost": "contact has a fixed growth, see costs.ObstacleCost",
    "collision_cost": "contact has a fixed growth, see costs.ObstacleCost",
    "collision_margin_distance": "the margin beyond the robot is not a setting of this controller",
    "cost_scaling_factor": "the cost near obstacles grows quadratically",
    "consider_footprint": "the footprint is always considered",
    "inflation_layer_name": "there is one distance field",
    "near_collision_cost": "contact has a fixed growth, see costs.ObstacleCost",
    "trajectory_point_step": "every step of a rollout is priced",
    "threshold_to_consider": _NEAR_GOAL,
    "near_goal_distance": _NEAR_GOAL,
    "offset_from_furthest": _NEAR_GOAL,
    "max_path_occupancy_ratio": _NEAR_GOAL,
    "max_angle_to_furthest": _NEAR_GOAL,
    "use_path_orientations": "the path has the directions of its curve",
    "angular_dist_threshold": _SHIM,
    "angular_disengage_threshold": _SHIM,
    "forward_sampling_distance": _SHIM,
    "rotate_to_heading_angular_vel": _SHIM,
    "rotate_to_heading_once": _SHIM,
    "rotate_to_goal_heading": _SHIM,
    "max_angular_accel": _SHIM,
    "simulate_ahead_time": _SHIM,
    "closed_loop": _SHIM,
}


def of_critic(name: str, task: str) -> str:
    """Return why a critic has no counterpart."""
    known = {**_CRITICS, **(_CRITICS_ALONG_A_PATH if task == "path" else {})}
    return known.get(name, "the critic is not known")


def of_parameter(name: str) -> str:
    """Return why a parameter, such as `CostCritic.critical_cost`, has no counterpart."""
    first, _, last = name.partition(".")
    return _PARAMETERS.get(first) or _PARAMETERS.get(last) or "the parameter is not known"
