"""A stateless planner with the interface of other MPPI libraries."""
