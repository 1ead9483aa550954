"""Elevation models: files of heights by window, with their position on the ground."""
