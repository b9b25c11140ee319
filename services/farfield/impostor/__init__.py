"""Leaf: view cells, layer placement, resolution, memory and cost estimates: the error metric."""
