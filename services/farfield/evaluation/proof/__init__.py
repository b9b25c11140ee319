"""Placement database and level -> how far pictures with an impostor are from pictures with its geometry."""
