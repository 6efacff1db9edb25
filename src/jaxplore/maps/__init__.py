"""Maps: occupancy grids, terrain, worlds, map files and generated maps."""
