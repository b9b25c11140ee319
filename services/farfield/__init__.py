"""farfield: impostors placed so that every view of a static 3D level meets its frame-time budget."""
