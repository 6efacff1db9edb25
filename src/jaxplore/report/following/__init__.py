"""Metrics, figures and animation of a path-following run."""
