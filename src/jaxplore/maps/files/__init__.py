"""Read and write map, path and image files."""
