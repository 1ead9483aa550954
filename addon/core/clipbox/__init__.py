"""Nested clip-boxes: unbounded volumetric terrain around a viewer."""
