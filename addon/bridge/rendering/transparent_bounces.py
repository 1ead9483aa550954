"""The number of transparent bounces that Cycles needs for quads behind quads."""

import math
from collections.abc import Sequence

import bpy
import numpy as np

from ...core.arrays import TINY
from ..geometry.mesh_arrays import read_positions

MIN_BOUNCES, MAX_BOUNCES = 32.0, 1024.0  # the maximum is that of Cycles


def estimate_transparent_bounces(levels: Sequence[bpy.types.Object], all_visible: bool = False) -> int:
    """Estimate the transparent bounces with which Cycles shows stacked quads without rendering the deeper ones black: 32 to 1024.

    Four times the mean number of quads on a line through the bounding sphere, for the level where this is largest, or summed over the
    levels if they are `all_visible` at once.
    """
    bounces = []
    for level in levels:
        if len(level.data.polygons) == 0:  # somebody has deleted the quads
            continue
        longest_side = float(np.ptp(read_positions(level.data), axis=0).max())
        bounces.append(4.0 * sum(polygon.area for polygon in level.data.polygons) / max(0.25 * math.pi * longest_side**2, TINY))
    return int(min(max(MIN_BOUNCES, sum(bounces) if all_visible else max(bounces, default=0.0)), MAX_BOUNCES))


def ensure_transparent_bounces(scene: bpy.types.Scene, bounces: int) -> None:
    """Raise the scene's limit of transparent bounces to `bounces`. A higher limit stays. Cycles renders deeper surfaces black."""
    if hasattr(scene, "cycles"):
        scene.cycles.transparent_max_bounces = max(scene.cycles.transparent_max_bounces, bounces)
