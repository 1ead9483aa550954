"""Basis tables as images that a shader looks up: what goes where, the numbers that lead there, and the way back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..direction_grids import DirectionGrid
from .factors import Factors
from .settings import LARGEST_SIDE
from .shadows import Shadows

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class ViewTable:
    """An image with one texel a view, bordered blocks above each other: place * scale + start + (cluster * column, k * step).

    A block for every component; for every four, in red, green, blue and alpha, where components are numbers and no colours.
    """

    image: np.ndarray
    scale: Vector
    start: Vector
    step: float
    column: float


@dataclass(frozen=True)
class Tables:
    """Images (H, W, 4) float32, row 0 at the bottom, and how to look them up. A place is (x, y) in 0..1 on an octahedral map.

    basis: blocks of (views + 2) x (views + 2) tiles of (lights + 2) x (lights + 2) lights, one block above the other for every component
    and one column of them for every cluster; tile (0, 0) is the border. The texel of place p under tap t of view cell c, and component k,
    is at (c + t) * tile_scale + light * light_scale + light_start + (cluster * column, k * step), where c = floor(view * views + 0.5).
    """

    views: int
    views_upper: bool
    lights: int
    lights_upper: bool
    clusters: int
    components: int
    alpha_components: int
    basis: np.ndarray
    tile_scale: Vector
    light_scale: Vector
    light_start: Vector
    step: float
    column: float
    dome: ViewTable
    alpha: ViewTable
    shadows: int
    shadows_upper: bool
    shadow_components: int
    shadow: ViewTable | None


def tables_of(colour: Factors, alpha: Factors, views: DirectionGrid, lights: DirectionGrid, shadows: Shadows | None = None) -> Tables:
    """The tables of a bake: `colour` has a column for every light, the dome last, and channel; `alpha` has one column.

    The one of `shadows`, whose side is 0 where there are none, has the directions of suns in the place of views.
    """
    count, components, clusters = len(lights), colour.components, colour.clusters
    values = colour.basis.reshape(len(views), clusters, components, count + 1, 3)
    tiles = lights.bordered(np.moveaxis(values[..., :count, :], 3, 0))  # light row, light column, view, cluster, component, channel
    blocks = views.bordered(np.moveaxis(tiles, 2, 0))  # view row, view column, light row, light column, cluster, component, channel
    wide, tall = blocks.shape[0], blocks.shape[2]
    width, height = clusters * wide * tall, components * wide * tall
    # component, view row, light row; cluster, view column, light column
    basis = blocks.transpose(5, 0, 2, 4, 1, 3, 6).reshape(height, width, 3)
    return Tables(
        views=views.size,
        views_upper=views.upper,
        lights=lights.size,
        lights_upper=lights.upper,
        clusters=clusters,
        components=components,
        alpha_components=alpha.components,
        basis=_opaque(basis),
        tile_scale=(tall / width, tall / height, 0.0),
        light_scale=(lights.size / width, lights.size / height, 0.0),
        light_start=(1.0 / width, 1.0 / height, 0.0),
        step=1.0 / components,
        column=1.0 / clusters,
        dome=_view_table(views, values[..., count, :]),
        alpha=_number_table(views, alpha.basis),
        shadows=0 if shadows is None else shadows.grid.size,
        shadows_upper=False if shadows is None else shadows.grid.upper,
        shadow_components=0 if shadows is None else shadows.angles.components,
        shadow=None if shadows is None else _number_table(shadows.grid, shadows.angles.basis),
    )


def colour_basis(
    basis: np.ndarray, dome: np.ndarray, views: DirectionGrid, lights: DirectionGrid, clusters: int, components: int
) -> np.ndarray:
    """The basis (V, clusters * components, (L + 1) * 3) of colours out of the images (H, W, 4) that `tables_of` has made of it."""
    wide, tall = views.size + 2, lights.size + 2
    blocks = basis[..., :3].reshape(components, wide, tall, clusters, wide, tall, 3)[:, 1:-1, 1:-1, :, 1:-1, 1:-1]
    # view row, view column, cluster, component, light row, light column, channel
    suns = blocks.transpose(1, 4, 3, 0, 2, 5, 6).reshape(len(views), clusters * components, len(lights), 3)
    under_dome = _view_values(dome, views, clusters, components)[..., :3]
    return np.concatenate([suns, under_dome[:, :, None]], axis=2).reshape(len(views), clusters * components, -1)


def one_column_basis(image: np.ndarray, views: DirectionGrid, components: int) -> np.ndarray:
    """The basis (V, components, 1) of silhouettes, or of shadows, out of the image (H, W, 4) that `tables_of` has made of it."""
    return _view_values(image, views, 1, -(-components // 4)).reshape(len(views), -1, 1)[:, :components]


def weight_images(weights: np.ndarray, tallest: int = LARGEST_SIDE) -> list[np.ndarray]:
    """`weights` (H, W, K) as images (B * H, W, 4), blocks of four components above each other, the last filled up with 0; as few images as
    are no higher than `tallest`, since engines can look up few at a time."""
    blocks = -(-weights.shape[2] // 4)
    padded = np.pad(weights, ((0, 0), (0, 0), (0, 4 * blocks - weights.shape[2])))
    stacked = np.moveaxis(padded.reshape(*weights.shape[:2], blocks, 4), 2, 0)
    most = max(1, tallest // max(weights.shape[0], 1))
    return [np.concatenate(stacked[start : start + most]) for start in range(0, blocks, most)]


def weights_in(images: Sequence[np.ndarray], height: int, components: int) -> np.ndarray:
    """The weights (height, W, components) out of the images that `weight_images` has made of them."""
    blocks = np.concatenate(images).reshape(-1, height, *images[0].shape[1:])
    return np.concatenate(list(blocks), axis=2)[..., :components]


def _view_table(views: DirectionGrid, values: np.ndarray) -> ViewTable:
    """The table of `values` (V, clusters, K, 3 or 4)."""
    maps = views.bordered(values)
    wide, clusters, components = maps.shape[1:4]
    width, height = clusters * wide, components * wide
    image = maps.transpose(3, 0, 2, 1, 4).reshape(height, width, -1)
    scale, start = (views.size / width, views.size / height, 0.0), (1.0 / width, 1.0 / height, 0.0)
    return ViewTable(_opaque(image) if image.shape[2] == 3 else image.astype(np.float32), scale, start, 1.0 / components, 1.0 / clusters)


def _number_table(views: DirectionGrid, basis: np.ndarray) -> ViewTable:
    """The table of a `basis` (V, K, 1) of numbers."""
    padded = np.pad(basis[..., 0], ((0, 0), (0, -basis.shape[1] % 4)))
    return _view_table(views, padded.reshape(len(views), 1, -1, 4))


def _view_values(image: np.ndarray, views: DirectionGrid, clusters: int, components: int) -> np.ndarray:
    """The values (V, clusters * components, 4) that `_view_table` has put in `image`."""
    wide = views.size + 2
    maps = image.reshape(components, wide, clusters, wide, 4)[:, 1:-1, :, 1:-1]
    return maps.transpose(1, 3, 2, 0, 4).reshape(len(views), clusters * components, 4)


def _opaque(image: np.ndarray) -> np.ndarray:
    return np.concatenate([image, np.ones_like(image[..., :1])], axis=2).astype(np.float32)
