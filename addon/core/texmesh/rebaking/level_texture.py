"""The texture of one level: at each texel the color of the original surface at the nearest point."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry.mesh import face_areas_and_normals
from ...imaging.images import dilate
from ...imaging.mipmaps import Mipmaps, build_mipmaps, sample_mipmaps
from ...imaging.raster import rasterize
from ...jobs.progress import Progress, Steps
from ..refitting.correspondence import SurfaceSamples, compute_uv_scale, match_islands, sample_surface
from ..refitting.outliers import FineSurface
from ..textured_mesh import TexturedMesh
from .image_sizes import choose_supersampling, halve_size
from .surface_descent import SurfaceDescent
from .uv_layout import wrap_triangles

# Samples of the original, by which triangles are assigned to UV islands.
MIN_SAMPLES, MAX_SAMPLES, SAMPLES_PER_TRIANGLE = 16_000, 300_000, 4
TRIANGLE_FRACTION = 0.5  # This fraction of them is divided evenly among triangles.
BLANK_WEIGHT = 1e-3  # Weight of texels that no triangle of the original covers.
CHUNK_SAMPLES = 1 << 18  # texels that are looked for at once


@dataclass(frozen=True)
class OriginalSurface:
    """The original. groups: (T,) number of the texture of each triangle, -1 for none."""

    mesh: TexturedMesh
    groups: np.ndarray

    @cached_property
    def surface(self) -> FineSurface:
        """The surface with its UV islands."""
        return FineSurface.of(self.mesh)

    @cached_property
    def descent(self) -> SurfaceDescent:
        """Searches for the nearest point."""
        return SurfaceDescent(self.mesh.vertices, self.mesh.triangles, self.groups)

    @cached_property
    def samples(self) -> SurfaceSamples:
        """Points on the surface."""
        count = int(np.clip(SAMPLES_PER_TRIANGLE * len(self.mesh.triangles), MIN_SAMPLES, MAX_SAMPLES))
        return sample_surface(self.mesh, self.surface.islands, count, np.random.default_rng(0), TRIANGLE_FRACTION)

    def match_islands(self, level: TexturedMesh) -> np.ndarray:
        """Return the UV island (T,) of the original that each triangle of a level belongs to."""
        return match_islands(self.samples, self.mesh.materials[self.samples.triangles], level, compute_uv_scale(self.mesh))


def build_weighted_mipmaps(texture: np.ndarray, corner_uvs: np.ndarray) -> Mipmaps:
    """Return mipmaps of a texture (H, W, C) whose values are multiplied by weights, which follow as the last channel: 1 at texels that
    triangles (T, 3, 2) cover, BLANK_WEIGHT elsewhere. So colors outside of UV islands do not bleed into coarse levels."""
    height, width = texture.shape[:2]
    weights = np.full(width * height, BLANK_WEIGHT, np.float32)
    for _, texels, _ in rasterize(wrap_triangles(corner_uvs)[0] * (width, height), (width, height)):
        weights[texels] = 1.0
    weights = weights.reshape(height, width, 1)
    return build_mipmaps(np.concatenate([texture * weights, weights], axis=2))


def rebake_texture(
    original: OriginalSurface,
    group: int,
    mipmaps: Mipmaps,
    level: TexturedMesh,
    islands: np.ndarray,
    triangles: np.ndarray,
    halvings: int,
) -> Steps[np.ndarray]:
    """Return the texture (H, W, C) float32 of a level: the colors of the original surface, filtered by area. Texels around UV islands
    continue the colors of these.

    Args:
        group: of the texture in `original`. mipmaps: of the texture, from `build_weighted_mipmaps`. islands: (T,) of the level, from
            `OriginalSurface.match_islands`. triangles: (K,) of the level, those with the texture. halvings: of the sides of the texture.
    """
    full = tuple(mipmaps.sizes[0].tolist())
    size = halve_size(full, halvings)
    factor = choose_supersampling(full, halvings)
    footprint = 2.0**halvings / factor
    sums = np.zeros((size[0] * size[1], mipmaps.texels.shape[1] - 1), np.float32)
    counts = np.zeros(size[0] * size[1], np.float32)
    yield Progress(0.0, "Rebaking textures")
    for fraction, owners, uvs, texels, barycentric in _find_samples(level, triangles, size, factor):
        found, coordinates = _find_original(original, level, islands, owners, uvs, barycentric)
        has_texture = original.groups[found] == group
        corner_uvs = original.mesh.uvs[original.mesh.wedge_triangles[found]]
        values = sample_mipmaps(mipmaps, np.einsum("ni,nic->nc", coordinates, corner_uvs), np.full(len(found), footprint))
        colors = values[has_texture, :-1] / values[has_texture, -1:]
        texels = texels[has_texture]
        for channel in range(sums.shape[1]):
            sums[:, channel] += np.bincount(texels, colors[:, channel], len(counts))
        counts += np.bincount(texels, minlength=len(counts))
        yield Progress(fraction, "Rebaking textures")
    image = (sums / np.maximum(counts, 1.0)[:, None]).reshape(size[1], size[0], -1)
    return dilate(image, (counts / factor**2).reshape(size[1], size[0]))


def _find_samples(
    level: TexturedMesh, triangles: np.ndarray, size: tuple[int, int], factor: int
) -> Iterator[tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield, some samples at a time, the fraction of triangles that are done, and for each sample its triangle of the level (N,), texture
    coordinates (N, 2), texel (N,) and barycentric coordinates (N, 3). There are `factor` samples per texel along each side."""
    corners, owners = wrap_triangles(level.corner_uvs[triangles])
    fine_size = (size[0] * factor, size[1] * factor)
    pending, total = [], 0
    seen = np.zeros(fine_size[0] * fine_size[1], bool)  # texels on edges belong to one triangle
    for rows, samples, barycentric in rasterize(corners * fine_size, fine_size):
        _, first = np.unique(samples, return_index=True)
        first = first[~seen[samples[first]]]
        seen[samples[first]] = True
        pending.append((triangles[owners[rows[first]]], samples[first], barycentric[first]))
        total += len(first)
        if total >= CHUNK_SAMPLES:
            yield _join_samples(level, pending, size, factor, int(rows[-1]) / len(corners))
            pending, total = [], 0
    if total:
        yield _join_samples(level, pending, size, factor, 1.0)


def _join_samples(level: TexturedMesh, parts: list[tuple], size: tuple[int, int], factor: int, fraction: float) -> tuple:
    found, samples, barycentric = (np.concatenate(values) for values in zip(*parts, strict=True))
    barycentric = np.maximum(barycentric, 0.0)
    barycentric /= barycentric.sum(axis=1, keepdims=True)
    rows, columns = np.divmod(samples, size[0] * factor)
    uvs = np.einsum("ni,nic->nc", barycentric, level.corner_uvs[found])
    return fraction, found, uvs, rows // factor * size[0] + columns // factor, barycentric


def _find_original(
    original: OriginalSurface, level: TexturedMesh, islands: np.ndarray, triangles: np.ndarray, uvs: np.ndarray, barycentric: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles (N,) of the original and barycentric coordinates (N, 3) that correspond to points of a level: the nearest points
    on the same side, found from the points with the same texture coordinates."""
    corners = level.vertices[level.triangles[triangles]]
    points = np.einsum("ni,nic->nc", barycentric, corners)
    normals = face_areas_and_normals(corners)[1]
    start = original.surface.find_points(points, uvs, islands[triangles])
    return original.descent.find_nearest(points, normals, start.triangles)
