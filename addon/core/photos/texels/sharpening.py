"""Detail that resampling has blurred, brought back into a texture.

A texel is interpolated between pixels, and a pixel that shows the texture is interpolated between texels: both blur. The texture is
therefore drawn from each camera, and the differences to the photographs are added to the texels that show them, which is one step towards
the texture that reproduces the photographs best (iterative back-projection: Irani and Peleg, "Improving Resolution by Image Registration",
1991).
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import convolve1d, gaussian_filter

from ...files.scratch import Scratch
from ...geometry.mesh import TriangleMesh
from ...imaging.images import sample_bilinear
from ...imaging.raster import draw_ids, locate_positions
from ...jobs.chunks import map_ordered, slices
from ...jobs.progress import Progress, Steps
from ..photographs.photograph import Photograph
from ..photographs.views import View
from .painter import TexelPainter

CHUNK_ROWS = 64  # rows of a photograph that are compared at once
RELAXATION = 1.5  # One step that is so much longer comes about as far as two.
MAX_DARKENING = 0.75
NOISE_FILTER = (1.0, -2.0, 1.0)  # along rows and columns
NOISE_GAIN = 6.0 / np.sqrt(3.0)  # standard deviation of the filtered mean of the channels, for noise of 1 in each
MAX_RESIDUAL = 0.2  # Larger differences of encoded colors come from something else.
DETAIL_SIZE = 4.0  # pixels, standard deviation of a Gaussian: coarser differences are no detail


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
    in place of its pixels; zero where it does not show the mesh or is not used.

    Args:
        mesh: relative to the cameras of the views. texel_corners: (T, 3, 2), positions in the texture.
        texture: (H', W', 4) float32, encoded colors, and 1 where there are some; otherwise all channels are 0.
        scratch: keeps the result, each photograph in the group of its index.
    """
    residuals: list[Photograph] = []

    def draw(index: int) -> np.ndarray:
        return _draw_residual(painter, index, views[index], mesh, texel_corners, texture)

    for pixels in map_ordered(draw, range(len(photographs))):
        index = len(residuals)
        residuals.append(replace(photographs[index], pixels=scratch.keep(pixels, index), mask=None, displacements=None))
        scratch.release(index)
        yield Progress((index + 1) / len(photographs), "Comparing texture and photographs")
    return residuals


def estimate_noise(photographs: list[Photograph]) -> float:
    """Return the typical standard deviation of the noise in a channel of the encoded colors of photographs (Immerkaer, "Fast Noise Variance
    Estimation", 1996, with a median)."""
    deviations = []
    for photograph in photographs:
        gray = photograph.pixels.mean(axis=2, dtype=np.float32)
        filtered = convolve1d(convolve1d(gray, NOISE_FILTER, axis=0), NOISE_FILTER, axis=1)
        deviations.append(float(np.median(np.abs(filtered))) / (0.6745 * NOISE_GAIN * photograph.white))
    return float(np.median(deviations))


def sharpen_colors(colors: np.ndarray, change: np.ndarray, noise: float) -> np.ndarray:
    """Return `colors` (N, 3) after the step `change` (N, 3), of which little is left where it is smaller than the `noise`. No color loses
    more than MAX_DARKENING of itself, so that none becomes black."""
    power = np.square(change).mean(axis=1, keepdims=True)
    step = np.float32(RELAXATION) * change * (power / (power + np.float32(max(noise, 1e-6) ** 2)))
    return np.maximum(colors + step, np.float32(1.0 - MAX_DARKENING) * colors)


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
        shown = np.where(view.uses(located), owners[lines, columns], -1)
        covered = np.flatnonzero(shown >= 0)
        triangles = shown[covered]
        barycentric = locate_positions(projected.corners[triangles], depths[triangles], located[covered])
        barycentric = np.maximum(barycentric, 0.0)  # the lens moves the center of a pixel within the pinhole image
        barycentric /= barycentric.sum(axis=1, keepdims=True)
        places = np.einsum("ni,nic->nc", barycentric, texels[triangles])
        result = np.full((len(positions), 3), np.nan, np.float32)
        drawn = sample_bilinear(texture, places)
        with np.errstate(divide="ignore", invalid="ignore"):
            result[covered] = painter.sample(index, positions[covered]) - drawn[:, :3] / drawn[:, 3:]
        return result.reshape(-1, width, 3)

    return _keep_detail(np.concatenate([compare(rows) for rows in slices(height, CHUNK_ROWS)]))


def _keep_detail(residual: np.ndarray) -> np.ndarray:
    """Return a residual (H, W, 3) without what is coarser than details: other exposures and shading. It is 0 where it is not a number, or
    too large for a detail that resampling has blurred."""
    with np.errstate(invalid="ignore"):
        known = (np.abs(residual) < MAX_RESIDUAL).all(axis=2)
    residual[~known] = 0.0
    weights = gaussian_filter(known.astype(np.float32), DETAIL_SIZE)
    for channel in range(3):
        coarse = gaussian_filter(residual[..., channel], DETAIL_SIZE) / np.maximum(weights, 1e-6)
        residual[..., channel] -= np.where(known, coarse, 0.0)
    return residual
