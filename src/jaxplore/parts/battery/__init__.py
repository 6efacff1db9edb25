"""A battery, and the way to the dock where it is charged."""
