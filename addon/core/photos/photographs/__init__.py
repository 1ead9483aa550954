"""Photographs and what they show of a surface: cameras, visibility, backgrounds, colors, and parts that show something else."""
