"""Placement, Scene -> BakedLayers: layered impostors as cropped texel tiles."""
