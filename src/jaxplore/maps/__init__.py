"""Occupancy grids, ROS map files, clearance, generated worlds."""
