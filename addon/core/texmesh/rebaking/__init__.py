"""Textures of levels that show the color of the original at each point: smaller ones for coarser levels."""
