"""Packages of textured meshes that are sent over a network within a time limit (sections III.B, III.C, V and VI of the paper)."""
