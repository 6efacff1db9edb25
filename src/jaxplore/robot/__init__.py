"""The robot: all that runs on board, which knows no truth."""
