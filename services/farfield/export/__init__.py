"""Placement database -> files for other engines: impostors as textured polygons in glTF 2.0."""
