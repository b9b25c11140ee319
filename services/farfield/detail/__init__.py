"""Scene -> Levels: coarser versions of meshes, each with a proven error, for objects seen from afar."""
