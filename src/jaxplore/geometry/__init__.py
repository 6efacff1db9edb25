"""Geometry: angles, paths by arc length, footprints, outlines and exact ray traversal."""
