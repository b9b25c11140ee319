"""Scene file -> Scene: positions, indices, materials and objects as columns, on the fixed grid, in their final order."""
