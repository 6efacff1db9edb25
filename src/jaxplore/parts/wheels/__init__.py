"""Vehicles that can tip over."""
