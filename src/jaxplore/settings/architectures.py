"""Names of the architectures that explore, and the runs with some of them."""

from jaxplore.settings.code_names import is_own
from jaxplore.settings.readers import Readers, architectures

BASELINES = (
    "wander",
    "random-frontier",
    "nearest-frontier",
    "nearest-cluster",
    "gain-per-cost",
    "next-best-view",
    "discounted-information",
    "distance-advantage",
)
"""Rule-based explorers, which drive from target to target: see `jaxplore.planning.TargetRule`."""
GROUND = ("explorer", "portfolio", *BASELINES)
"""Architectures of ground vehicles."""
INFORMATIVE = ("two-layer", "parallel", "sequential")
"""Architectures of informative MPPI."""
QUADROTOR = (*INFORMATIVE, "random-walk", "goal")
"""Architectures whose robot is a quadrotor unless another one is named."""
ARCHITECTURES = (*GROUND, *QUADROTOR)
"""All architectures of the library."""

# A rule-based explorer drives to its target as `explorer` does. So does one by a rule of the
# user's.
EXPLORING = Readers(
    "explorer, rule-based explorers",
    lambda settings: (
        settings.architecture in ("explorer", *BASELINES) or is_own(settings.architecture)
    ),
    "architecture",
)
FUSING = architectures("portfolio")
FLYING = architectures(*QUADROTOR)
INFORMED = architectures(*INFORMATIVE)
BY_RULE = Readers(
    "rule-based explorers",
    lambda settings: settings.architecture in BASELINES or is_own(settings.architecture),
    "architecture",
)
