"""Exploration of a plane by one robot or a fleet."""
