"""The MPPI family."""
