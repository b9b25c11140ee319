"""Scene -> Hierarchy: clusters as a flat node array over depth-first objects."""
