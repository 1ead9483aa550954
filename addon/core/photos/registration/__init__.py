"""Cameras from pairs of points, and cameras and photographs that are fitted to the other photographs."""
