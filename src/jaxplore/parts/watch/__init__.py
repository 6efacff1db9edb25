"""Patrol and search: how long ago each cell was seen."""
