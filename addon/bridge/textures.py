"""The textures of one level of a cloud, as arrays."""

from dataclasses import dataclass

import numpy as np

from ..core.billboards.cloud import Level
from ..core.images import EMPTY, dilate, grow_outline


@dataclass(frozen=True)
class Maps:
    """What one side of the quads shows, in the layout of the level's atlas. All float32, row 0 at the bottom.

    colour (H, W, 4): scene-linear Rec.709, premultiplied; alpha is the share of the texel that is covered.
    normal (H, W, 3): unit, in world axes at the time of capture, on the side of the viewer.
    surface (H, W, 3): roughness, metallic, and depth: height over the plane of the quad along its normal, as a share -1..1 of the
    level's error. Normal and surface have a value in every texel.
    """

    colour: np.ndarray
    normal: np.ndarray
    surface: np.ndarray


@dataclass(frozen=True)
class LevelTextures:
    """Both sides of the quads of one level; both lie in the atlas as seen from the side of the quads' normals."""

    front: Maps
    back: Maps


def maps_of(colour: np.ndarray, normal: np.ndarray, surface: np.ndarray, level: Level, goes_on: np.ndarray) -> Maps:
    """The maps of one side out of its three renders (H, W, 4): premultiplied, with normal and depth moved to 0..1.

    goes_on: texels (H, W) bool into which outlines grow, since their surface goes on there (see `outlines`).
    """
    reach = level.atlas.gutter // 2 + 1
    directions = _straight(normal, reach) * 2.0 - 1.0
    lengths = np.linalg.norm(directions, axis=2, keepdims=True)
    directions = np.where(lengths > EMPTY, directions / np.maximum(lengths, EMPTY), np.float32([0.0, 0.0, 1.0]))
    properties = _straight(surface, reach)
    properties[..., 2] = properties[..., 2] * 2.0 - 1.0
    return Maps(grow_outline(np.clip(colour, 0.0, None), goes_on, reach), directions.astype(np.float32), properties)


def _straight(render: np.ndarray, reach: int) -> np.ndarray:
    """The mean over what covers each texel of a premultiplied render, and of its neighbours where nothing does."""
    coverage = render[..., 3]
    mean = render[..., :3] / np.maximum(coverage, EMPTY)[..., None]
    return dilate(np.clip(mean, 0.0, 1.0), coverage, reach)
