"""The greatest and smallest numbers that are accepted. Each bound stands here and nowhere else.

They are far beyond what people use, and keep a wrong digit or a hostile file from taking all
memory or time. Where sizes multiply, `jaxplore.tasks.memory` estimates the memory of a run.
"""

LARGEST = 1e12
"""Largest number of a setting, of either sign: its square is finite in float32."""
SMALLEST = 1e-12
"""Smallest positive number of a setting: its square and its inverse are not zero in float32."""

LONGEST = 1e6
"""Greatest length of something in the world [m]."""
BROADEST = 100.0
"""Greatest radius, length or clearance of a robot [m]."""
LONGEST_RANGE = 10_000.0
"""Greatest range of a sensor [m]."""
WIDEST = 100_000.0
"""Greatest side of a map that is made [m]."""
FINEST = 1e-3
"""Smallest side of a cell, and distance between nodes [m]."""
DEEPEST_OFFICE = 1e9
"""Greatest cells times height of a generated office [m]: its rooms are half as deep as it is high,
and the time to furnish one grows with the square of its depth."""
LONGEST_TIME = 1e8
"""Longest time [s]: three years."""
LONGEST_LATENCY = 100.0
"""Longest latency [s]."""
SHORTEST_TIME = 1e-5
"""Shortest step of a model [s]."""
HIGHEST_RATE = 10_000.0
"""Highest rate [Hz]."""
LOWEST_RATE = 1e-4
"""Lowest rate [Hz]."""

MOST_SAMPLES = 1_000_000
"""Greatest number of rollouts of a controller, K."""
MOST_STEPS_AHEAD = 100_000
"""Greatest number of steps of a horizon or a reference, T."""
MOST_OUTCOMES = 1_000
"""Greatest number of outcomes of each control sequence."""
MOST_BEAMS = 100_000
"""Greatest number of beams of a scan, B."""
MOST_DIRECTIONS = 1_000
"""Greatest number of directions or headings of an information field, D."""
MOST_DISCS = 1_000
"""Greatest number of discs that cover a robot."""
MOST_LOOKS = 100_000
"""Greatest number of scans of a second look."""
MOST_DELAY = 10_000
"""Greatest number of control periods between a command and its effect."""
MOST_OBSTACLES = 1_000
"""Greatest number of obstacles of a sort on a path, and of corners of one."""
MOST_PEOPLE = 200
"""Greatest number of people who walk on a map."""
MOST_TRACKS = 64
"""Greatest number of moving obstacles that are tracked at a time."""
MOST_BENDS = 200
"""Greatest number of bends of a generated track."""
MOST_LAPS = 1_000_000
"""Greatest number of laps."""
MOST_NAMES = 1_000
"""Greatest number of entries of a list or a mapping of settings."""
MOST_MEMBERS = 100
"""Greatest number of members of a portfolio."""
MOST_ROBOTS = 64
"""Greatest number of robots of a fleet: its compiled program has a part for each of them."""
MOST_STEPS = 1_000_000_000
"""Greatest number of control periods of a run, counted in 32 bits."""

MOST_SEEDS = 100_000
"""Greatest number of seeds of a comparison or a search."""
MOST_CANDIDATES = 1_000_000
"""Greatest number of candidates of a search, and of cells of its archive."""
MOST_AT_ONCE = 10_000
"""Greatest number of runs in one program, of candidates in a generation, of workers."""

MOST_VOXELS = 200_000_000
"""Greatest number of voxels of a volume."""
