"""A stateless planner with the interface of other MPPI libraries."""

from jaxplore.compat.batch import RolloutBatch as RolloutBatch
from jaxplore.compat.batch import rollout_batch as rollout_batch
from jaxplore.compat.planner import PlannedControl as PlannedControl
from jaxplore.compat.planner import Planner as Planner
