"""Tasks, distributed over processes or the workers of a Ray cluster."""
