"""Observations: the radiance and coverage of a level's texels, sampled from the renders of one view, and reference images of the view.

Silhouettes are refined against reference images, which show the source under low-order lights.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...billboards.texels import Texels
from ...geometry.cameras import OrthographicView
from ...geometry.directions import DirectionGrid

ID_BUFFER_SCALE = 3  # Resolution of the ID buffer relative to the other renders of a view.
SUBSAMPLES = 3  # Per side of a texel.
MAX_TABLE_BYTES = 10**8  # Larger dense tables of quads and faces are replaced by sorted keys.
MIN_COVERAGE = 0.1  # Summed over the subsamples of a texel; below it, its color is noise.
LOW_ORDER_LIGHTS = 5  # The constant and the three linear spherical harmonics of the suns, and the dome.


@dataclass(frozen=True)
class ViewRender:
    """The Cycles renders of one view. S is ID_BUFFER_SCALE.

    Attributes:
        radiance: (L, H, W, 3) float32, premultiplied, one image per light, without emission; or one per material channel.
        coverage: (H, W) alpha.
        face_ids: (S H, S W) int32, the face at the center of each pixel, -1 for none.
        heights: (S H, S W) height of that point above the view's center, towards the viewer.
        emission: (H, W, 3) emitted radiance; None when no material emits.
    """

    radiance: np.ndarray
    coverage: np.ndarray
    face_ids: np.ndarray
    heights: np.ndarray
    emission: np.ndarray | None = None


@dataclass(frozen=True)
class Observation:
    """Radiance and coverage of N texels from one view.

    Attributes:
        known: (N,) bool, not hidden by other surfaces.
        coverage: (N,) float32, alpha of the known texels, 0 for the others.
        visible: (M,) int32, texels with a color.
        subsample_counts: (M,) uint8, how many of their SUBSAMPLES x SUBSAMPLES subsamples were seen.
        radiance: (L, M, 3) float32, straight colors.
        emission: (M, 3), see `ViewRender`.
    """

    known: np.ndarray
    coverage: np.ndarray
    visible: np.ndarray
    subsample_counts: np.ndarray
    radiance: np.ndarray
    emission: np.ndarray | None = None


class QuadFaceTable:
    """Lookup of the faces that each quad shows.

    shown_face_offsets (Q + 1,), shown_faces (D,): quad q shows shown_faces[shown_face_offsets[q]:shown_face_offsets[q + 1]]. face_count:
    greater than every shown face.
    """

    def __init__(self, shown_face_offsets: np.ndarray, shown_faces: np.ndarray, face_count: int) -> None:
        quads = np.repeat(np.arange(len(shown_face_offsets) - 1), np.diff(shown_face_offsets))
        self._face_count = face_count
        self._table = None
        if (len(shown_face_offsets) - 1) * face_count <= MAX_TABLE_BYTES:
            self._table = np.zeros((len(shown_face_offsets) - 1, face_count), bool)
            self._table[quads, shown_faces] = True
        self._keys = np.sort(quads.astype(np.int64) * face_count + shown_faces)

    def contains(self, quads: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Return whether quads[i] shows faces[i], as bool. No quad shows a face of -1."""
        in_range = (faces >= 0) & (faces < self._face_count)
        if self._table is not None:
            return self._table[quads, np.where(in_range, faces, 0)] & in_range
        keys = quads.astype(np.int64) * self._face_count + faces
        indices = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        return (self._keys[indices] == keys) & in_range


def observe(texels: Texels, view: OrthographicView, render: ViewRender, quad_faces: QuadFaceTable, error: float) -> Observation:
    """Project subsamples of every texel along `view` into `render` and sample it where it shows the texel's own surface.

    A surface of another quad that is more than `error` (a length) in front of a texel hides the subsample: it stays unknown. A surface
    behind the texel, or no surface, means that the texel is empty there. A texel is known when at least half of its subsamples are.
    """
    visible_counts, empty_counts, coverage = np.zeros((3, len(texels)), np.float32)
    pixel_coverage = render.coverage.ravel()
    samples = []
    id_view = view.supersample(ID_BUFFER_SCALE)
    for row, column, is_visible, is_hidden in _subsample_visibility(texels, id_view, render.face_ids, render.heights, quad_faces, error):
        visible_counts += is_visible
        empty_counts += ~is_visible & ~is_hidden
        pixel = row // ID_BUFFER_SCALE * view.resolution + column // ID_BUFFER_SCALE
        coverage += np.where(is_visible, pixel_coverage[pixel], np.float32(0.0))
        samples.append((pixel, is_visible))
    known = visible_counts + empty_counts >= 0.5 * SUBSAMPLES**2
    visible = np.flatnonzero(coverage > MIN_COVERAGE).astype(np.int32)
    by_pixel = np.moveaxis(render.radiance if render.emission is None else [*render.radiance, render.emission], 0, 2)
    by_pixel = np.ascontiguousarray(by_pixel, np.float32).reshape(len(pixel_coverage), -1)
    colors = np.zeros((len(visible), by_pixel.shape[1]), np.float32)
    for pixel, is_visible in samples:
        rows = np.flatnonzero(is_visible[visible])
        colors[rows] += by_pixel[pixel[visible[rows]]]
    colors /= coverage[visible, None]
    radiance = colors.reshape(len(visible), by_pixel.shape[1] // 3, 3).swapaxes(0, 1)
    alpha = visible_counts / np.maximum(visible_counts + empty_counts, 1.0)
    emission = None if render.emission is None else radiance[-1]
    known_alpha, subsample_counts = np.where(known, alpha, np.float32(0.0)), visible_counts[visible].astype(np.uint8)
    return Observation(known, known_alpha, visible, subsample_counts, radiance[: len(render.radiance)], emission)


def visible_subsamples(
    texels: Texels, view: OrthographicView, face_ids: np.ndarray, heights: np.ndarray, quad_faces: QuadFaceTable, error: float
) -> tuple[np.ndarray, np.ndarray]:
    """Count the subsamples of every texel that are visible from a light, and those that another surface hides from it, (N,) float32 each.

    view: the view from the light, with its `face_ids` (H, W) and `heights` (H, W), see `ViewRender`. `error` is used as in `observe`.
    """
    visible_counts, hidden_counts = np.zeros((2, len(texels)), np.float32)
    for _, _, is_visible, is_hidden in _subsample_visibility(texels, view, face_ids, heights, quad_faces, error):
        visible_counts += is_visible
        hidden_counts += is_hidden
    return visible_counts, hidden_counts


def _subsample_visibility(
    texels: Texels, view: OrthographicView, face_ids: np.ndarray, heights: np.ndarray, quad_faces: QuadFaceTable, error: float
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield, for each of SUBSAMPLES x SUBSAMPLES subsamples of all texels: row and column (N,) in the ID buffer, whether it shows the
    texel's own surface, and whether it shows another quad's surface that hides the texel."""
    centers, center_heights = view.project(texels.positions)
    projected, projected_heights = view.project(view.center + texels.steps.reshape(-1, 3))
    steps, height_steps = (projected - 0.5 * view.resolution).reshape(-1, 2, 2), projected_heights.reshape(-1, 2)
    flat_ids, flat_heights = face_ids.ravel(), heights.ravel()
    offsets = (2.0 * np.arange(SUBSAMPLES) + 1.0) / (2.0 * SUBSAMPLES) - 0.5
    for offset in map(np.array, itertools.product(offsets, offsets)):
        positions = np.floor(centers + np.einsum("a,qac->qc", offset, steps)[texels.quad_indices])
        column, row = np.clip(positions, 0, view.resolution - 1).astype(np.int64).T
        pixel = row * view.resolution + column
        faces = flat_ids[pixel]
        is_visible = quad_faces.contains(texels.quad_indices, faces)
        is_in_front = flat_heights[pixel] > center_heights + (height_steps @ offset)[texels.quad_indices] + error
        yield row, column, is_visible, ~is_visible & (faces >= 0) & is_in_front


@dataclass(frozen=True)
class ReferenceImage:
    """The source from one view. colors (M, H, W, 3) float32: premultiplied, under M low-order lights. coverage (H, W) float32."""

    colors: np.ndarray
    coverage: np.ndarray


def low_order_lights(grid: DirectionGrid) -> np.ndarray:
    """Return five lights (L + 1, 5) as weights of the suns of `grid` and of the dome. Such sums hardly contain noise.

    The columns are the constant and the three linear spherical harmonics of the suns (negative weights subtract), and the dome.
    """
    lights = np.zeros((len(grid) + 1, LOW_ORDER_LIGHTS), np.float32)
    lights[:-1, :4] = grid.solid_angles[:, None] * np.column_stack([np.ones(len(grid)), grid.directions])
    lights[-1, 4] = 1.0
    return lights


def compute_reference_image(render: ViewRender, lights: np.ndarray) -> ReferenceImage:
    """Return `render` under `lights` (L, M), weights of its images; see `low_order_lights`."""
    return ReferenceImage(np.einsum("lhwc,lm->mhwc", render.radiance, lights, optimize=True), render.coverage)
