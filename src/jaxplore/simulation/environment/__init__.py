"""Scenarios as reinforcement-learning environments."""
