"""Exit codes of the command line."""

FAILED = 1
"""Some runs failed."""
BAD_INPUT = 2
"""Something that the user gave is not accepted."""
INTERRUPTED = 130
"""Ctrl-C, as of a shell: 128 plus the number of the signal."""
