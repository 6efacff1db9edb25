"""Portfolios: several MPPI controllers in parallel, whose plans are fused into one."""
