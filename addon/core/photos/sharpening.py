"""Detail that resampling has blurred, brought back into a texture.

A texel is interpolated between pixels, and a pixel that shows the texture is interpolated between texels: both blur. The texture is
therefore drawn from each camera, and the differences to the photographs are added to the texels that show them, which is one step towards
the texture that reproduces the photographs best (iterative back-projection: Irani and Peleg, "Improving Resolution by Image Registration",
1991).
"""

from dataclasses import replace

import numpy as np

from ..files.scratch import Scratch
from ..geometry.mesh import TriangleMesh
from ..imaging.images import sample_bilinear
from ..imaging.raster import draw_ids
from ..imaging.texture_renders import locate_positions
from ..jobs.chunks import map_ordered, slices
from ..jobs.progress import Progress, Steps
from .photographs import Photograph
from .texel_colors import TexelPainter
from .views import View

CHUNK_ROWS = 64  # of a photograph at once


def find_residuals(
    painter: TexelPainter,
    photographs: list[Photograph],
    views: list[View],
    mesh: TriangleMesh,
    texel_corners: np.ndarray,
    texture: np.ndarray,
    scratch: Scratch,
) -> Steps[list[Photograph]]:
    """Return for each photograph by how much (H, W, 3) float32 its colors, as `painter` samples them, differ from those of the `texture`,
    in place of its pixels; zero where it does not show the mesh.

    Args:
        mesh: relative to the cameras of the views. texel_corners: (T, 3, 2), positions in the texture.
        texture: (H', W', 3) float32, encoded.
        scratch: keeps the result, each photograph in the group of its index.
    """
    residuals = []
    for index, (photograph, view) in enumerate(zip(photographs, views, strict=True)):
        yield Progress(index / len(photographs), "Comparing texture and photographs")
        pixels = _draw_residual(painter, index, view, mesh, texel_corners, texture)
        residuals.append(replace(photograph, pixels=scratch.keep(pixels, index), mask=None, displacements=None))
        scratch.release(index)
    return residuals


def _draw_residual(
    painter: TexelPainter, index: int, view: View, mesh: TriangleMesh, texel_corners: np.ndarray, texture: np.ndarray
) -> np.ndarray:
    """Return by how much (H, W, 3) the photograph with this `index` differs from the texture."""
    width, height = view.camera.lens.size
    projected = view.project_pinhole(mesh)
    owners, _ = draw_ids(projected.corners, -projected.inverse_depths, projected.size)
    depths, texels = 1.0 / projected.inverse_depths, texel_corners[projected.indices]

    def compare(rows: slice) -> np.ndarray:
        grid = np.mgrid[rows.start : min(rows.stop, height), :width]
        positions = grid[::-1].reshape(2, -1).T + 0.5
        located = view.locate_in_pinhole(positions)
        columns, lines = np.floor(np.maximum(located, 0.0)).astype(np.int64).T
        shown = np.where(located[:, 0] >= 0.0, owners[lines, columns], -1)
        covered = np.flatnonzero(shown >= 0)
        triangles = shown[covered]
        barycentric = locate_positions(projected.corners[triangles], depths[triangles], located[covered])
        barycentric = np.maximum(barycentric, 0.0)  # the lens moves the center of a pixel within the pinhole image
        barycentric /= barycentric.sum(axis=1, keepdims=True)
        places = np.einsum("ni,nic->nc", barycentric, texels[triangles])
        result = np.zeros((len(positions), 3), np.float32)
        result[covered] = painter.sample(index, positions[covered]) - sample_bilinear(texture, places)
        return result.reshape(-1, width, 3)

    return np.concatenate(list(map_ordered(compare, slices(height, CHUNK_ROWS))))
