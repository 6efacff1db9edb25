"""Exploration of an unknown map, as a scenario."""
