"""Which blocks of textures images from all around show, how large, and with how many texels per pixel."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...geometry.directions import fibonacci_sphere
from ...imaging.mipmaps import measure_footprints
from ...imaging.raster import draw_ids, list_drawn, locate_positions
from ...jobs.progress import Progress, Steps
from ...texmesh.perception.views import Frame, frame_around, view_axes
from ...texmesh.textured_mesh import TexturedMesh
from .texture_tiles import TextureSource, TileGrid

BLOCK = 8  # texels of a side of a block
MIN_SAMPLES = 512  # Samples along a side of an image; fewer would miss texels.
FOOTPRINT_STEP = 0.5  # Step of the binary logarithm of texels per pixel.
MIN_LOG_FOOTPRINT, MAX_LOG_FOOTPRINT = -2.0, 6.0
FOOTPRINT_LEVELS = int((MAX_LOG_FOOTPRINT - MIN_LOG_FOOTPRINT) / FOOTPRINT_STEP) + 1


def level_footprints() -> np.ndarray:
    """Return the texels per pixel (FOOTPRINT_LEVELS,) of the levels that footprints are rounded to."""
    return 2.0 ** (MIN_LOG_FOOTPRINT + FOOTPRINT_STEP * np.arange(FOOTPRINT_LEVELS))


def measure_visibility(
    sources: Sequence[TextureSource], grids: Sequence[TileGrid], view_count: int, pixels: int
) -> Steps[list[np.ndarray]]:
    """Return for each source the fraction of the pixels of its mesh that show a block of the texture at a level of footprints:
    (rows, columns, FOOTPRINT_LEVELS) float32 of the padded texture, row 0 at the top.

    The sum is 1 for a texture that the whole mesh uses. Sources of the same mesh share their renders.

    Args:
        view_count: views from all around, without perspective. pixels: side of the square around the object in the image.
    """
    results = [np.zeros((rows // BLOCK * (columns // BLOCK), FOOTPRINT_LEVELS)) for rows, columns in (grid.padded_shape for grid in grids)]
    covered = [0] * len(sources)
    samples = max(pixels, MIN_SAMPLES)
    directions = fibonacci_sphere(view_count)
    surfaces = {id(source.mesh): _Surface(source.mesh, source.mesh.corner_uvs, frame_around(source.mesh.vertices)) for source in sources}
    for number, direction in enumerate(directions):
        yield Progress(number / view_count, "Measuring visibility")
        for key, surface in surfaces.items():
            seen = surface.look(direction, samples)
            materials = surface.mesh.materials[seen.triangles].take(seen.rows)
            for index, (source, grid) in enumerate(zip(sources, grids, strict=True)):
                if id(source.mesh) != key:
                    continue
                covered[index] += len(seen.rows)
                corner_uvs = surface.corner_uvs[seen.triangles]
                footprints = measure_footprints(seen.corners * (pixels / samples), corner_uvs, (grid.width, grid.height))
                used = np.isin(materials, source.materials)
                _count(results[index], seen.uvs[used], _round_footprints(footprints)[seen.rows[used]], grid)
    return [
        (counts / max(total, 1)).reshape(grid.padded_shape[0] // BLOCK, grid.padded_shape[1] // BLOCK, FOOTPRINT_LEVELS).astype(np.float32)
        for counts, total, grid in zip(results, covered, grids, strict=True)
    ]


class _Seen(NamedTuple):
    """The samples of a view that show a surface: the T triangles that are seen, their corners (T, 3, 2) in samples, and for each of N
    samples the row of its triangle, and its texture coordinates (N, 2)."""

    triangles: np.ndarray
    corners: np.ndarray
    rows: np.ndarray
    uvs: np.ndarray


class _Surface(NamedTuple):
    """A mesh, its texture coordinates (T, 3, 2), and the frame of its views."""

    mesh: TexturedMesh
    corner_uvs: np.ndarray
    frame: Frame

    def look(self, direction: np.ndarray, samples: int) -> _Seen:
        """Return the samples of a view from `direction` (3,) with so many along each side."""
        positions = (self.mesh.vertices - self.frame.center) @ view_axes(direction).T
        corners = (positions[:, :2] / self.frame.side + 0.5).take(self.mesh.triangles, axis=0) * samples
        owners, _ = draw_ids(corners, -positions[:, 2].take(self.mesh.triangles), (samples, samples))
        shown = np.flatnonzero(owners.ravel() >= 0)
        owners = owners.ravel()[shown]
        triangles, rows = list_drawn(owners, len(corners))
        centers = np.stack([shown % samples, shown // samples], axis=1) + 0.5
        barycentric = locate_positions(corners.take(owners, axis=0), np.ones((len(rows), 3)), centers)
        uvs = np.einsum("ni,nic->nc", barycentric, self.corner_uvs.take(owners, axis=0))
        return _Seen(triangles, corners[triangles], rows, uvs)


def _round_footprints(footprints: np.ndarray) -> np.ndarray:
    """Return the levels (T,) that `footprints` (T,) are rounded to."""
    logarithms = np.log2(np.clip(footprints, 2.0**MIN_LOG_FOOTPRINT, 2.0**MAX_LOG_FOOTPRINT))
    return np.rint((logarithms - MIN_LOG_FOOTPRINT) / FOOTPRINT_STEP).astype(np.int64)


def _count(counts: np.ndarray, uvs: np.ndarray, levels: np.ndarray, grid: TileGrid) -> None:
    """Add one for each sample to `counts` (blocks, FOOTPRINT_LEVELS)."""
    texels = (uvs * [1.0, -1.0] + [0.0, 1.0]) % 1.0 * [grid.width, grid.height]
    blocks = np.minimum(texels.astype(np.int64), [grid.width - 1, grid.height - 1]) // BLOCK
    indices = (blocks[:, 1] * (grid.padded_shape[1] // BLOCK) + blocks[:, 0]) * FOOTPRINT_LEVELS + levels
    values, added = np.unique(indices, return_counts=True)
    counts.reshape(-1)[values] += added
