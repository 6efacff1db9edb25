"""Several MPPI controllers side by side, and the fusion of their plans."""
