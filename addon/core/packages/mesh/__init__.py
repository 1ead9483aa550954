"""Meshes of packages: their order, their triangles as symbols, and their positions as differences from predictions."""
