"""Speed and exploration, measured. `make bench` writes JSON and prints tables."""
