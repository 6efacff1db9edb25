"""Targets that are to be found, and end the task."""
