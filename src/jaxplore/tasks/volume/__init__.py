"""Exploration of a volume by a quadrotor."""
