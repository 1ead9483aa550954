"""Which blocks of textures images from all around show, how large, and with how many texels per pixel."""

from collections.abc import Sequence

import numpy as np

from ....geometry.directions import fibonacci_sphere
from ....imaging.mipmaps import measure_footprints
from ....imaging.raster import draw_ids
from ....imaging.texture_renders import locate_positions
from ....jobs.progress import Progress, Steps
from ...perception.views import frame_around, view_axes
from .texture_tiles import TextureSource, TileGrid

BLOCK = 8  # texels of a side of a block
MIN_SAMPLES = 512  # of a side of an image: smaller ones would miss texels
FOOTPRINT_STEP = 0.5  # of the binary logarithm of texels per pixel
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
    meshes = {id(source.mesh): source.mesh for source in sources}
    for number, direction in enumerate(directions):
        yield Progress(number / view_count, "Measuring visibility")
        for key, mesh in meshes.items():
            frame, axes = frame_around(mesh.vertices), view_axes(direction)
            positions = (mesh.vertices - frame.center) @ axes.T
            corners = ((positions[:, :2] / frame.side + 0.5) * samples)[mesh.triangles]
            owners, _ = draw_ids(corners, -positions[:, 2][mesh.triangles], (samples, samples))
            shown = np.flatnonzero(owners.ravel() >= 0)
            triangles = owners.ravel()[shown]
            centers = np.stack([shown % samples, shown // samples], axis=1) + 0.5
            barycentric = locate_positions(corners[triangles], np.ones((len(triangles), 3)), centers)
            uvs = np.einsum("ni,nic->nc", barycentric, mesh.corner_uvs[triangles])
            for index, (source, grid) in enumerate(zip(sources, grids, strict=True)):
                if id(source.mesh) != key:
                    continue
                covered[index] += len(shown)
                footprints = measure_footprints(corners * (pixels / samples), mesh.corner_uvs, (grid.width, grid.height))
                rows = np.isin(mesh.materials[triangles], source.materials)
                _count(results[index], uvs[rows], footprints[triangles[rows]], grid)
    return [
        (counts / max(total, 1)).reshape(grid.padded_shape[0] // BLOCK, grid.padded_shape[1] // BLOCK, FOOTPRINT_LEVELS).astype(np.float32)
        for counts, total, grid in zip(results, covered, grids, strict=True)
    ]


def _count(counts: np.ndarray, uvs: np.ndarray, footprints: np.ndarray, grid: TileGrid) -> None:
    """Add one for each sample to `counts` (blocks, FOOTPRINT_LEVELS)."""
    texels = (uvs * [1.0, -1.0] + [0.0, 1.0]) % 1.0 * [grid.width, grid.height]
    blocks = np.minimum(texels.astype(np.int64), [grid.width - 1, grid.height - 1]) // BLOCK
    levels = np.clip(np.rint((np.log2(footprints) - MIN_LOG_FOOTPRINT) / FOOTPRINT_STEP), 0, FOOTPRINT_LEVELS - 1).astype(np.int64)
    indices = (blocks[:, 1] * (grid.padded_shape[1] // BLOCK) + blocks[:, 0]) * FOOTPRINT_LEVELS + levels
    counts += np.bincount(indices, minlength=counts.size).reshape(counts.shape)
