"""Building of experiments from settings."""
