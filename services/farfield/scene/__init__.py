"""Scene file -> Scene: positions, indices, materials, objects as columns, on the fixed grid, in final order."""
