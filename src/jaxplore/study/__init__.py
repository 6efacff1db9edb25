"""Many runs: comparisons and searches, on one machine or a cluster."""
