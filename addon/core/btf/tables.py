"""Basis tables as images that a shader looks up: what goes where, and the numbers that lead there."""

from dataclasses import dataclass

import numpy as np

from ..direction_grids import DirectionGrid
from .factors import Factors

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class ViewTable:
    """An image with one texel a view, bordered blocks above each other: place * scale + start + (0, k * step)."""

    image: np.ndarray
    scale: Vector
    start: Vector
    step: float


@dataclass(frozen=True)
class Tables:
    """Images (H, W, 4) float32, row 0 at the bottom, and how to look them up. A place is (x, y) in 0..1 on an octahedral map.

    basis: blocks of (views + 2) x (views + 2) tiles of (lights + 2) x (lights + 2) lights, one block above the other for every component;
    tile (0, 0) is the border. The texel of place p under tap t of view cell c, and component k, is at
    (c + t) * tile_scale + light * light_scale + light_start + (0, k * step), where c = floor(view * views + 0.5).
    """

    views: int
    views_upper: bool
    lights_upper: bool
    components: int
    alpha_components: int
    basis: np.ndarray
    tile_scale: Vector
    light_scale: Vector
    light_start: Vector
    step: float
    dome: ViewTable
    alpha: ViewTable


def tables_of(colour: Factors, alpha: Factors, views: DirectionGrid, lights: DirectionGrid) -> Tables:
    """The tables of a bake: `colour` has a column for every light, the dome last, and channel; `alpha` has one column."""
    count, components = len(lights), colour.components
    values = colour.basis.reshape(len(views), components, count + 1, 3)
    tiles = lights.bordered(np.moveaxis(values[:, :, :count], 2, 0))  # light row, light column, view, component, channel
    blocks = views.bordered(np.moveaxis(tiles, 2, 0))  # view row, view column, light row, light column, component, channel
    wide, tall = blocks.shape[0], blocks.shape[2]
    # component, view row, light row; view column, light column
    basis = blocks.transpose(4, 0, 2, 1, 3, 5).reshape(components * wide * tall, wide * tall, 3)
    width, height = wide * tall, components * wide * tall
    return Tables(
        views=views.size,
        views_upper=views.upper,
        lights_upper=lights.upper,
        components=components,
        alpha_components=alpha.components,
        basis=_opaque(basis),
        tile_scale=(tall / width, tall / height, 0.0),
        light_scale=(lights.size / width, lights.size / height, 0.0),
        light_start=(1.0 / width, 1.0 / height, 0.0),
        step=1.0 / components,
        dome=_view_table(views, values[:, :, count]),
        alpha=_view_table(views, np.repeat(alpha.basis, 3, axis=2)),
    )


def weight_images(weights: np.ndarray) -> list[np.ndarray]:
    """`weights` (H, W, K) as images (H, W, 4), four components each, the last filled up with 0."""
    missing = -weights.shape[2] % 4
    padded = np.concatenate([weights, np.zeros((*weights.shape[:2], missing), weights.dtype)], axis=2)
    return [padded[..., start : start + 4] for start in range(0, padded.shape[2], 4)]


def _view_table(views: DirectionGrid, values: np.ndarray) -> ViewTable:
    """The table of `values` (V, K, 3)."""
    maps = views.bordered(values)
    wide, components = maps.shape[1:3]
    image = maps.transpose(2, 0, 1, 3).reshape(-1, wide, 3)
    height = wide * components
    return ViewTable(_opaque(image), (views.size / wide, views.size / height, 0.0), (1.0 / wide, 1.0 / height, 0.0), 1.0 / components)


def _opaque(image: np.ndarray) -> np.ndarray:
    return np.concatenate([image, np.ones_like(image[..., :1])], axis=2).astype(np.float32)
