"""How far photographs are from what the other photographs show of the same surface: displacements at blocks of a photograph.

From the camera of a photograph, the image is drawn that the others give of the mesh: at each pixel the mean of their colors at the point on
the surface. Its blocks are looked for in the photograph. Both are pinhole images, which straighten what the lens distorts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates

from ...files.scratch import Scratch
from ...geometry.lenses import PhotoCamera
from ...imaging.block_matching import match_blocks
from ...imaging.colors import LUMINANCE
from ...imaging.images import nearest_known
from ...imaging.pyramids import reduce_image
from ...imaging.raster import locate_pixels
from ...jobs.chunks import slices
from ...jobs.progress import Progress, Steps
from ..photographs.photograph import Photograph, apply_gain, shift_positions
from ..photographs.surface import Surface
from ..photographs.views import View, find_frame

MAX_SIDE = 1024  # pixels of the compared images
MAX_GRAY_SIDE = 1536  # pixels of the photographs that they are drawn from; larger ones are reduced to a half, a quarter, ...
MAX_OTHERS = 8  # photographs that are compared with one: those that show most of the same surface
MARGIN = 32  # pixels around the surface
PROBES = 4000  # pixels that decide which those are
CHUNK = 1 << 18  # pixels at once


class Matches(NamedTuple):
    """N places of a photograph that were found again.

    Attributes:
        points: (N, 3) on the surface.
        positions: (N, 2) in pixels where the camera projects them.
        displacements: (N, 2) in pixels from there to where the photograph shows what the others show of the points.
        confidences: (N,) 0 to 1.
        fractions: (N,) 0 to 1, the weight of the others in the mean of all photographs.
    """

    points: np.ndarray
    positions: np.ndarray
    displacements: np.ndarray
    confidences: np.ndarray
    fractions: np.ndarray

    @property
    def mean_displacement(self) -> float:
        """The mean length of the displacements in pixels, by confidence."""
        return float(np.average(np.linalg.norm(self.displacements, axis=1), weights=self.confidences))


@dataclass(frozen=True)
class GrayPhotograph:
    """A photograph for matching.

    Attributes:
        view: what it shows.
        gray: (h, w) float32, its luminance, encoded and with adjusted exposure.
        factor: by which that is smaller than the photograph.
        mask, displacements: those of the photograph.
    """

    view: View
    gray: np.ndarray
    factor: int
    mask: np.ndarray | None
    displacements: np.ndarray | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the photograph in pixels."""
        return self.view.camera.lens.size

    def sample(self, positions: np.ndarray) -> np.ndarray:
        """Return the luminance (N,) float32 that belongs to `positions` (N, 2) in pixels of the photograph."""
        x, y = ((shift_positions(positions, self.displacements, self.size) - 0.5) / self.factor).T
        return map_coordinates(self.gray, (y, x), np.float32, 1, mode="nearest")

    def contains(self, positions: np.ndarray) -> np.ndarray:
        """Return whether `positions` (N, 2) lie in the frame and in the mask."""
        columns, rows = np.floor(positions).astype(np.int64).T
        inside = (columns >= 0) & (columns < self.size[0]) & (rows >= 0) & (rows < self.size[1])
        if self.mask is not None:
            inside[inside] = self.mask[rows[inside], columns[inside]]
        return inside


def make_gray(photograph: Photograph, view: View, gain: np.ndarray) -> GrayPhotograph:
    """Return the photograph for matching; `gain` (3,) adjusts its exposure."""
    pixels = photograph.pixels
    scale = np.float32(1.0 / photograph.white)
    gray = np.empty(pixels.shape[0] * pixels.shape[1], np.float32)
    for part in slices(len(gray), CHUNK):
        gray[part] = apply_gain(pixels.reshape(-1, 3)[part] * scale, gain) @ LUMINANCE
    gray, factor = gray.reshape(pixels.shape[:2]), 1
    while max(gray.shape) > MAX_GRAY_SIDE:
        gray, factor = reduce_image(gray), 2 * factor
    return GrayPhotograph(view, gray, factor, photograph.mask, photograph.displacements)


def make_grays(
    photographs: Sequence[Photograph], views: Sequence[View], gains: Sequence[np.ndarray], scratch: Scratch
) -> Steps[list[GrayPhotograph]]:
    """Return the photographs for matching; `scratch` keeps their luminance, each in the group of its index."""
    grays = []
    for index, (photograph, view, gain) in enumerate(zip(photographs, views, gains, strict=True)):
        yield Progress(index / len(photographs), "Comparing photographs")
        gray = make_gray(photograph, view, gain)
        grays.append(replace(gray, gray=scratch.keep(gray.gray, index)))
        scratch.release(index)
    return grays


def match_others(photographs: list[GrayPhotograph], index: int, surface: Surface, scratch: Scratch) -> Matches:
    """Return where the photograph with this index shows what all others show, and let `scratch` release the images."""
    matches = match_photograph(photographs[index], photographs[:index] + photographs[index + 1 :], surface)
    for group in range(len(photographs)):
        scratch.release(group)
    return matches


def match_photograph(photograph: GrayPhotograph, others: Sequence[GrayPhotograph], surface: Surface) -> Matches:
    """Return where a photograph shows what the `others` show of the `surface`; there may be no match."""
    frame = _Frame(photograph.view.camera, surface)
    if not len(frame.points):
        return Matches(*(np.zeros(shape) for shape in ((0, 3), (0, 2), (0, 2), 0, 0)))
    seen = photograph.view.see(frame.points, frame.normals)
    points, normals = frame.points[seen.indices], frame.normals[seen.indices]
    means, weights = _average(_choose(others, points, normals), points, normals)
    shape = frame.covered.shape
    reference, fractions, indices = np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.full(shape, -1)
    rows, columns = (axis[seen.indices] for axis in np.nonzero(frame.covered))
    shown = np.flatnonzero(weights > 0.0)
    reference[rows[shown], columns[shown]] = means[shown]
    fractions[rows[shown], columns[shown]] = weights[shown] / (weights + seen.weights)[shown]
    indices[rows[shown], columns[shown]] = shown
    positions, is_valid = frame.locate(np.stack(np.meshgrid(*(np.arange(side) + 0.5 for side in shape[::-1])), axis=-1).reshape(-1, 2))
    is_valid &= photograph.contains(positions)
    image = photograph.sample(positions).reshape(shape)
    known = indices >= 0
    found = match_blocks(reference, image, known, is_valid.reshape(shape))
    nearest_rows, nearest_columns = nearest_known(known)
    x, y = np.minimum(found.centers.astype(np.int64), np.array(shape[::-1]) - 1).T
    rows, columns = nearest_rows[y, x], nearest_columns[y, x]
    centers = np.stack([columns, rows], axis=1) + 0.5
    (start, is_start), (end, is_end) = frame.locate(centers), frame.locate(centers + found.displacements)
    kept = is_start & is_end
    return Matches(
        points[indices[rows, columns]][kept], start[kept], (end - start)[kept], found.confidences[kept], fractions[rows, columns][kept]
    )


class _Frame:
    """The part of the pinhole image of a photograph in which the surface is; row 0 is at the top of the photograph.

    covered: (h, w) bool, N pixels with a surface, at points (N, 3) with unit normals (N, 3).
    """

    def __init__(self, camera: PhotoCamera, surface: Surface) -> None:
        self._lens = camera.lens
        low, size = find_frame(camera)
        scale = min(1.0, MAX_SIDE / max(size))
        self._focal = scale * float(np.mean(camera.lens.focal))
        mesh, limits = surface.mesh, np.ceil(scale * np.array(size)).astype(int)
        local = mesh.vertices @ camera.rotation.T + camera.translation
        in_front = local[:, 2] > 1e-6 * max(float(np.abs(local[:, 2]).max(initial=0.0)), 1e-12)
        depths = np.where(in_front, local[:, 2], 1.0)
        pixels = (local[:, :2] / depths[:, None] - low) * self._focal
        kept = np.flatnonzero(in_front[mesh.triangles].all(axis=1))
        used = pixels[mesh.triangles[kept]].reshape(-1, 2)
        first = np.clip(np.floor(used.min(axis=0, initial=np.inf)) - MARGIN, 0, limits) if len(used) else np.zeros(2)
        last = np.clip(np.ceil(used.max(axis=0, initial=-np.inf)) + MARGIN, 1, limits) if len(used) else np.ones(2)
        self._low = low + first / self._focal
        width, height = np.maximum(last - first, 1).astype(int)
        located = locate_pixels((pixels - first)[mesh.triangles[kept]], depths[mesh.triangles[kept]], (int(width), int(height)))
        self.covered = located.covered
        self.points = located.interpolate(mesh.vertices[mesh.triangles[kept]])
        normals = located.interpolate(surface.corner_normals[kept])
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)

    def locate(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the positions (N, 2) in the photograph of `pixels` (N, 2) of the frame, and whether (N,) the lens shows them."""
        return self._lens.project(np.column_stack([pixels / self._focal + self._low, np.ones(len(pixels))]))


def _choose(others: Sequence[GrayPhotograph], points: np.ndarray, normals: np.ndarray) -> list[GrayPhotograph]:
    """Return those of the photographs that show the most of `points` (N, 3)."""
    probes = slice(None, None, max(len(points) // PROBES, 1))
    counts = [len(other.view.see(points[probes], normals[probes]).indices) for other in others]
    best = np.argsort(-np.array(counts), kind="stable")[:MAX_OTHERS]
    return [others[index] for index in best if counts[index]]


def _average(photographs: Sequence[GrayPhotograph], points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the weighted means (N,) float32 of what photographs show of `points` (N, 3), and the sums of their weights (N,)."""
    sums, weights = np.zeros(len(points), np.float32), np.zeros(len(points), np.float32)
    for photograph in photographs:
        seen = photograph.view.see(points, normals)
        sums[seen.indices] += seen.weights * photograph.sample(seen.positions)
        weights[seen.indices] += seen.weights
    return sums / np.where(weights > 0.0, weights, 1.0), weights
