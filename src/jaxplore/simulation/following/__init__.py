"""Path following, as a scenario."""
