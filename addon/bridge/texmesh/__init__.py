"""Conversion between textured meshes and Blender objects."""
