"""Sensors: simulated scans, and what they do to a belief."""
