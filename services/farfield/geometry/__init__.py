"""Leaf: boxes, cell trees, direction intervals and frusta; knows no stage."""
