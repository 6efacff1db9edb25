"""Distribution of tasks over processes or the workers of a Ray cluster."""
