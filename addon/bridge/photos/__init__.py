"""Textures from photographs: surfaces, photographs and results as Blender data."""
