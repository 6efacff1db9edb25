"""Costs: the terms that a controller minimises."""
