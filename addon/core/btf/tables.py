"""Lookup tables: the bases of relightable textures as images for a shader, the coordinates to sample them at, and the way back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.directions import DirectionGrid
from .factorization.factors import Factors
from .reflectance.shadows import Shadows
from .settings import MAX_IMAGE_SIDE

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class ViewTable:
    """An image with one texel per view, in padded blocks: a column of blocks for every cluster, a row of blocks for every component.

    The texel coordinate of map position p, component k and cluster c is p * scale + offset + (c * cluster_step, k * component_step).
    Scalar components are stored in groups of four, in red, green, blue and alpha; k is then the group.

    Attributes:
        image: (H, W, 4) float32.
        scale: Factor of the map position.
        offset: Added to it.
        component_step: Step from one component to the next.
        cluster_step: Step from one cluster to the next.
    """

    image: np.ndarray
    scale: Vector
    offset: Vector
    component_step: float
    cluster_step: float


@dataclass(frozen=True)
class LookupTables:
    """Images (H, W, 4) float32, row 0 at the bottom, and the coordinates to sample them at. Map positions are (x, y) in 0..1.

    `basis` has blocks of (views_per_side + 2)^2 tiles of (lights_per_side + 2)^2 lights; a row of blocks for every component and a column
    of blocks for every cluster; tile (0, 0) is padding. The texel of map position `light` under tap t of view cell c and component k is at
    (c + t) * tile_scale + light * light_scale + light_offset + (cluster * cluster_step, k * component_step), where
    c = floor(view * views_per_side + 0.5).

    Attributes:
        views_per_side, views_upper: Grid of the views.
        lights_per_side, lights_upper: Grid of the lights.
        clusters, components, alpha_components: Numbers of clusters, and of components of color and alpha.
        basis: Image of the colors.
        tile_scale, light_scale, light_offset, component_step, cluster_step: Coordinates in `basis`.
        dome: Table of the colors under the dome, by view.
        alpha: Table of alpha, by view.
        shadows_per_side, shadows_upper, shadow_components: Grid and components of self-shadowing; shadows_per_side is 0 without it.
        shadow: Table of the visibility of lights, by light direction; None without self-shadowing.
    """

    views_per_side: int
    views_upper: bool
    lights_per_side: int
    lights_upper: bool
    clusters: int
    components: int
    alpha_components: int
    basis: np.ndarray
    tile_scale: Vector
    light_scale: Vector
    light_offset: Vector
    component_step: float
    cluster_step: float
    dome: ViewTable
    alpha: ViewTable
    shadows_per_side: int
    shadows_upper: bool
    shadow_components: int
    shadow: ViewTable | None


def build_tables(
    color: Factors, alpha: Factors, views: DirectionGrid, lights: DirectionGrid, shadows: Shadows | None = None
) -> LookupTables:
    """Build the lookup tables. The columns of `color` are lights, the dome last, times channels; `alpha` has one column."""
    count, components, clusters = len(lights), color.components, color.clusters
    values = color.basis.reshape(len(views), clusters, components, count + 1, 3)
    tiles = lights.pad(np.moveaxis(values[..., :count, :], 3, 0))  # Light row, light column, view, cluster, component, channel.
    blocks = views.pad(np.moveaxis(tiles, 2, 0))  # View row, view column, light row, light column, cluster, component, channel.
    view_side, light_side = blocks.shape[0], blocks.shape[2]
    width, height = clusters * view_side * light_side, components * view_side * light_side
    # Component, view row, light row; cluster, view column, light column.
    basis = blocks.transpose(5, 0, 2, 4, 1, 3, 6).reshape(height, width, 3)
    return LookupTables(
        views_per_side=views.size,
        views_upper=views.upper,
        lights_per_side=lights.size,
        lights_upper=lights.upper,
        clusters=clusters,
        components=components,
        alpha_components=alpha.components,
        basis=_add_alpha(basis),
        tile_scale=(light_side / width, light_side / height, 0.0),
        light_scale=(lights.size / width, lights.size / height, 0.0),
        light_offset=(1.0 / width, 1.0 / height, 0.0),
        component_step=1.0 / components,
        cluster_step=1.0 / clusters,
        dome=_build_view_table(views, values[..., count, :]),
        alpha=build_alpha_table(alpha, views),
        shadows_per_side=0 if shadows is None else shadows.grid.size,
        shadows_upper=False if shadows is None else shadows.grid.upper,
        shadow_components=0 if shadows is None else shadows.angles.components,
        shadow=None if shadows is None else _build_scalar_table(shadows.grid, shadows.angles.basis),
    )


def build_alpha_table(alpha: Factors, views: DirectionGrid) -> ViewTable:
    """Build the table of `alpha`, factors with one column."""
    return _build_scalar_table(views, alpha.basis)


def unpack_color_basis(
    basis: np.ndarray, dome: np.ndarray, views: DirectionGrid, lights: DirectionGrid, clusters: int, components: int
) -> np.ndarray:
    """Return the color basis (V, clusters * components, (L + 1) * 3) from the `basis` and `dome` images (H, W, 4) of `build_tables`."""
    view_side, light_side = views.size + 2, lights.size + 2
    blocks = basis[..., :3].reshape(components, view_side, light_side, clusters, view_side, light_side, 3)
    blocks = blocks[:, 1:-1, 1:-1, :, 1:-1, 1:-1]
    # View row, view column, cluster, component, light row, light column, channel.
    suns = blocks.transpose(1, 4, 3, 0, 2, 5, 6).reshape(len(views), clusters * components, len(lights), 3)
    dome_basis = _unpack_view_table(dome, views, clusters, components)[..., :3]
    return np.concatenate([suns, dome_basis[:, :, None]], axis=2).reshape(len(views), clusters * components, -1)


def unpack_scalar_basis(image: np.ndarray, views: DirectionGrid, components: int) -> np.ndarray:
    """Return the basis (V, components, 1) of alpha or shadows from the image (H, W, 4) of its table in `build_tables`."""
    return _unpack_view_table(image, views, 1, -(-components // 4)).reshape(len(views), -1, 1)[:, :components]


def pack_weights(weights: np.ndarray, max_height: int = MAX_IMAGE_SIDE) -> list[np.ndarray]:
    """Pack `weights` (H, W, K) into images (B * H, W, 4): blocks of four components above each other, the last one padded with 0.

    Returns as few images as possible with at most `max_height` rows, since render engines support few images per shader.
    """
    block_count = -(-weights.shape[2] // 4)
    padded = np.pad(weights, ((0, 0), (0, 0), (0, 4 * block_count - weights.shape[2])))
    blocks = np.moveaxis(padded.reshape(*weights.shape[:2], block_count, 4), 2, 0)
    max_blocks = max(1, max_height // max(weights.shape[0], 1))
    return [np.concatenate(blocks[start : start + max_blocks]) for start in range(0, block_count, max_blocks)]


def unpack_weights(images: Sequence[np.ndarray], height: int, components: int) -> np.ndarray:
    """Return the weights (height, W, components) from the images of `pack_weights`."""
    blocks = np.concatenate(images).reshape(-1, height, *images[0].shape[1:])
    return np.concatenate(list(blocks), axis=2)[..., :components]


def _build_view_table(views: DirectionGrid, values: np.ndarray) -> ViewTable:
    """Build the table of `values` (V, clusters, K, 3 or 4)."""
    maps = views.pad(values)
    side, clusters, components = maps.shape[1:4]
    width, height = clusters * side, components * side
    image = maps.transpose(3, 0, 2, 1, 4).reshape(height, width, -1)
    scale, offset = (views.size / width, views.size / height, 0.0), (1.0 / width, 1.0 / height, 0.0)
    return ViewTable(
        _add_alpha(image) if image.shape[2] == 3 else image.astype(np.float32), scale, offset, 1.0 / components, 1.0 / clusters
    )


def _build_scalar_table(views: DirectionGrid, basis: np.ndarray) -> ViewTable:
    """Build the table of a `basis` (V, K, 1) of scalars."""
    padded = np.pad(basis[..., 0], ((0, 0), (0, -basis.shape[1] % 4)))
    return _build_view_table(views, padded.reshape(len(views), 1, -1, 4))


def _unpack_view_table(image: np.ndarray, views: DirectionGrid, clusters: int, components: int) -> np.ndarray:
    """Return the values (V, clusters * components, 4) from the image of `_build_view_table`."""
    side = views.size + 2
    maps = image.reshape(components, side, clusters, side, 4)[:, 1:-1, :, 1:-1]
    return maps.transpose(1, 3, 2, 0, 4).reshape(len(views), clusters * components, 4)


def _add_alpha(image: np.ndarray) -> np.ndarray:
    return np.concatenate([image, np.ones_like(image[..., :1])], axis=2).astype(np.float32)
