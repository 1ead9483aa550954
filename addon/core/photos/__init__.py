"""Textures from photographs: one seamless texture for a mesh from registered photographs."""
