"""Planners with the interface of other MPPI libraries."""
