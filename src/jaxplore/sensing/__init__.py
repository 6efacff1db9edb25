"""Sensors: simulated scans, and map updates from scans."""
