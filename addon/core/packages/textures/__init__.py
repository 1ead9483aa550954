"""Textures of packages: tiles as progressive JPEG files whose scans are sent in the order in which they improve the image most per byte."""
