"""The texture maps of one level of a cloud: as arrays, as Blender images with the material that shows them, and as corner normals.

Cycles lights a normal-mapped surface only from the side that its smooth normal faces. A quad shows faces that deviate by up to 60 degrees
from it, so with its flat normal a whole quad would stay dark at a grazing angle where it should be lit. Corner normals that follow the
normal map, as well as a linear field can, make this test correct nearly everywhere.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...core.billboards.cloud import Level
from ...core.imaging.images import MIN_ALPHA, dilate, grow_silhouette, mean_over_coverage, nearest_known, unpremultiply
from ...core.imaging.metrics import encode_srgb
from ..imaging.images import create_image
from ..shading.shared_parameters import Value
from .atlas_meshes import separate_heights
from .cloud_materials import COLOR, NORMAL, ROUGHNESS_METALLIC_DEPTH, ShownLayer, create_cloud_material
from .layer_maps import LayerMaps, create_layer_images

MIN_COSINE = 0.2  # Between a corner's normal and the quad's; with less a corner would face away.
RIDGE = 1e-3  # Tikhonov regularization of the slopes, relative to the total weight: keeps the fit of one row of texels well posed.
# Quads cast no shadow on surfaces within this many errors: quads of one surface overlap within that distance.
SHADOWLESS_ERRORS = 4.0


@dataclass(frozen=True)
class PbrMaps:
    """The PBR maps of one side of the quads, in the layout of the level's atlas. All float32, row 0 at the bottom.

    color (H, W, 4): scene-linear Rec.709, premultiplied; alpha is the covered fraction of the texel.
    normal (H, W, 3): unit, in world axes at the time of capture, on the viewer's side.
    roughness_metallic_depth (H, W, 3): depth is the height above the quad's plane along its normal, -1..1 as a fraction of the level's
    error. This map and `normal` have a value in every texel.
    near_visibility (H, W): light that reaches the surface in the texel, as a fraction of that which its quad receives; `color`
    is already multiplied by it. Images store at most 1; None if it is 1 everywhere.
    """

    color: np.ndarray
    normal: np.ndarray
    roughness_metallic_depth: np.ndarray
    near_visibility: np.ndarray | None = None


@dataclass(frozen=True)
class LevelTextures:
    """Both sides of the quads of one level. Both lie in the atlas as seen from the side of the quads' normals.

    layers: by name, see `surface_layers`. parameters: inputs of a Principled shader that the whole surface has in common.
    """

    front: PbrMaps
    back: PbrMaps
    layers: Mapping[str, LayerMaps] = field(default_factory=dict)
    parameters: Mapping[str, Value] = field(default_factory=dict)


def compute_maps(
    color: np.ndarray,
    normal: np.ndarray,
    roughness_metallic_depth: np.ndarray,
    level: Level,
    continuation: np.ndarray,
    uncovered: np.ndarray,
) -> PbrMaps:
    """Compute the maps of one side from its three renders (H, W, 4): premultiplied, with normal and depth encoded in 0..1.

    continuation: mask (H, W) bool of the texels into which silhouettes grow, because the surface continues there; uncovered: quads (H, W)
    int32 of the texels that get the color and alpha of the next texel of their quad, -1 elsewhere (see `silhouettes`). The depth of charts
    is 0, because they have the shape of the surface.
    """
    quads = level.atlas.quad_map
    directions = mean_over_coverage(normal, regions=quads) * 2.0 - 1.0
    lengths = np.linalg.norm(directions, axis=2, keepdims=True)
    directions = np.where(lengths > MIN_ALPHA, directions / np.maximum(lengths, MIN_ALPHA), np.float32([0.0, 0.0, 1.0]))
    parameters = mean_over_coverage(roughness_metallic_depth, regions=quads)
    parameters[..., 2] = parameters[..., 2] * 2.0 - 1.0
    for quad, chart in enumerate(level.charts):
        depths = parameters[(*_cell(level, quad), 2)]
        depths -= depths if chart is not None else separate_heights(quad, 1.0)
    color = _fill_charts(np.clip(color, 0.0, None), level, uncovered)
    return PbrMaps(grow_silhouette(color, continuation, quads), directions.astype(np.float32), parameters)


def _cell(level: Level, quad: int) -> tuple[slice, slice]:
    """Return the rows and columns of the texels that belong to a quad."""
    x, y, width, height = level.atlas.rectangles[quad].tolist()
    return slice(y, y + height), slice(x, x + width)


def _fill_charts(color: np.ndarray, level: Level, uncovered: np.ndarray) -> np.ndarray:
    """Return `color` (H, W, 4) with the nearest texel of the same quad in the `uncovered` texels."""
    filled = color.copy()
    for quad in np.unique(uncovered[uncovered >= 0]):
        cell = _cell(level, quad)
        is_unknown = uncovered[cell] == quad
        if not is_unknown.all():
            rows, columns = nearest_known(~is_unknown)
            filled[cell] = color[cell][rows, columns]
    return filled


def compute_corner_normals(level: Level, maps: PbrMaps, quad: int, cutout: np.ndarray) -> np.ndarray:
    """Compute unit normals (C, 3) in world space at the points `cutout` (C, 2), in -1..1 of the half sizes of one `quad`.

    They are a linear least-squares fit to the normals of the quad's texels in `maps`, weighted by coverage. Where the texel normals
    disagree so much that their mean is short, as in foliage, the result is blended with the quad's own normal.
    """
    x, y, width, height = level.atlas.rectangles[quad]
    normals = maps.normal[y : y + height, x : x + width].reshape(-1, 3).astype(np.float64)
    weights = maps.color[y : y + height, x : x + width, 3].ravel().astype(np.float64)
    quad_normal = level.quads.frames[quad, 2]
    if weights.sum() <= 0.0:
        return np.tile(quad_normal, (len(cutout), 1))
    rows, columns = np.divmod(np.arange(width * height), width)
    half_texel = 0.5 * level.texel_size  # Smaller quads have one texel, at their center.
    scale = half_texel / np.maximum(level.quads.half_sizes[quad], half_texel)
    design = np.column_stack([(2 * columns + 1 - width) * scale[0], (2 * rows + 1 - height) * scale[1], np.ones(width * height)])
    ridge = RIDGE * weights.sum() * np.diag([1.0, 1.0, 0.0]) + 1e-9 * np.eye(3)
    weighted = design * weights[:, None]
    coefficients = np.linalg.solve(weighted.T @ design + ridge, weighted.T @ normals)
    fitted = np.column_stack([cutout, np.ones(len(cutout))]) @ coefficients
    agreement = min(float(np.linalg.norm(coefficients[2])), 1.0)
    return _limit_angle(fitted + (1.0 - agreement) * quad_normal, quad_normal)


def _limit_angle(directions: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Normalize `directions` (C, 3) and rotate those that deviate too far from `axis` (3,) towards it."""
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    unit = np.where(lengths > 1e-9, directions / np.maximum(lengths, 1e-9), axis)
    cosines = unit @ axis
    tangent = unit - cosines[:, None] * axis
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    limited = MIN_COSINE * axis + np.sqrt(1.0 - MIN_COSINE**2) * tangent
    return np.where(cosines[:, None] < MIN_COSINE, limited, unit)


def create_textured_material(name: str, level: Level, textures: LevelTextures) -> bpy.types.Material:
    """Create a material with the images of `textures`, packed and named after it."""
    images = {}
    for side, maps in (("Front", textures.front), ("Back", textures.back)):
        for map_name, pixels in _encode_maps(maps, level.atlas.quad_map).items():
            images[side, map_name] = create_image(f"{name} {side} {map_name}", pixels, is_data=map_name != COLOR)
    layers = {
        layer: ShownLayer(maps.scale, create_layer_images(name, layer, maps), maps.constant) for layer, maps in textures.layers.items()
    }
    return create_cloud_material(name, images, SHADOWLESS_ERRORS * level.error, layers, textures.parameters)


def _encode_maps(maps: PbrMaps, quads: np.ndarray) -> dict[str, np.ndarray]:
    """Encode the maps of one side for 8-bit images: (H, W, 4) in 0..1, color as straight sRGB. quads: see `AtlasLayout.quad_map`."""
    straight = unpremultiply(maps.color)
    alpha = np.clip(straight[..., 3:], 0.0, 1.0)
    color = dilate(straight[..., :3], maps.color[..., 3] * (maps.color[..., 3] > MIN_ALPHA), regions=quads)
    parameters = maps.roughness_metallic_depth * np.float32([1.0, 1.0, 0.5]) + np.float32([0.0, 0.0, 0.5])
    opaque = np.ones_like(alpha)
    near_visibility = opaque if maps.near_visibility is None else np.minimum(maps.near_visibility[..., None], 1.0)
    return {
        COLOR: np.concatenate([encode_srgb(color), alpha], axis=2),
        NORMAL: np.concatenate([0.5 + 0.5 * maps.normal, opaque], axis=2),
        ROUGHNESS_METALLIC_DEPTH: np.concatenate([parameters, near_visibility], axis=2),
    }
