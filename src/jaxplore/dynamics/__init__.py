"""Dynamics models of robots, and their integrators."""
