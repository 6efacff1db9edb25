"""Many runs: comparisons and searches, on one machine or a cluster."""

from jaxplore.study.comparison.compare import compare as compare
from jaxplore.study.comparison.comparison import Comparison as Comparison
