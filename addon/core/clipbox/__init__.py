"""Nested clip-boxes: volumetric terrain of any extent around a viewer, after `papers/nested-clip-boxes.txt`."""
