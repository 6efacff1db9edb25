"""A scenario as a reinforcement-learning environment."""
