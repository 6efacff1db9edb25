"""Comparisons and parameter searches over many runs, on one machine or a cluster."""

from jaxplore.study.comparison.compare import compare as compare
from jaxplore.study.comparison.comparison import Comparison as Comparison
from jaxplore.study.fleet_parts import simulate_in_parts as simulate_in_parts
