"""Solid parts of a cloud as meshes: simplified within the error, and divided into charts, each a quad with the shape of the surface."""
