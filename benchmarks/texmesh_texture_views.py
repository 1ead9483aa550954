"""FLIP of a textured mesh with decoded textures, in many views, for `texmesh_textures.py`."""

from collections.abc import Sequence

import numpy as np

from farfield.addon.core.imaging.colors import LINEAR_OF_BYTE
from farfield.addon.core.imaging.flip import FlipImage, compare, filter_radius, prepare_image
from farfield.addon.core.imaging.mipmaps import Mipmaps, build_mipmaps
from farfield.addon.core.texmesh.perception.views import frame_around, prepare_surface, render
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

PIXELS_PER_DEGREE = 67.0


class TextureJudge:
    """Compares textures of a mesh with the original ones.

    directions: (N, 3), of the views. pixels: side of the images.
    """

    def __init__(self, mesh: TexturedMesh, images: Sequence[np.ndarray | None], directions: np.ndarray, pixels: int) -> None:
        self._mesh, self._directions, self._pixels = mesh, directions, pixels
        self._frame = frame_around(mesh.vertices)
        self._windows: list[tuple[slice, slice]] = []
        self._coverages: list[np.ndarray] = []
        self._references: list[FlipImage] = []
        surface = prepare_surface(mesh, [to_mipmaps(image) for image in images])
        for direction in directions:
            picture = render(surface, direction, self._frame, pixels)
            window = _find_window(picture.coverage)
            self._windows.append(window)
            self._coverages.append(picture.coverage[window])
            self._references.append(prepare_image(picture.colors[window], PIXELS_PER_DEGREE, is_linear=True))

    def measure_flip(self, images: Sequence[np.ndarray | None], mesh: TexturedMesh | None = None) -> float:
        """Return the mean FLIP error of the pixels of the object in all views, with another mesh if one is given."""
        surface = prepare_surface(self._mesh if mesh is None else mesh, [to_mipmaps(image) for image in images])
        total, count = 0.0, 0
        for direction, window, coverage, reference in zip(self._directions, self._windows, self._coverages, self._references, strict=True):
            picture = render(surface, direction, self._frame, self._pixels)
            error = compare(reference, prepare_image(picture.colors[window], PIXELS_PER_DEGREE, is_linear=True))
            total += float(error[coverage].sum())
            count += int(coverage.sum())
        return total / count


def to_mipmaps(image: np.ndarray | None) -> Mipmaps | None:
    """Return the mipmaps, linear, of an image (H, W, 3) uint8."""
    return None if image is None else build_mipmaps(LINEAR_OF_BYTE[image])


def random_directions(count: int, generator: np.random.Generator) -> np.ndarray:
    """Return (count, 3) unit vectors."""
    directions = generator.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _find_window(coverage: np.ndarray) -> tuple[slice, slice]:
    """Return rows and columns around the object with what FLIP filters see of it; the background is the same everywhere."""
    radius = filter_radius(PIXELS_PER_DEGREE)
    window = []
    for axis in (1, 0):
        lines = np.flatnonzero(coverage.any(axis=axis))
        window.append(slice(max(int(lines[0]) - radius, 0), int(lines[-1]) + radius + 1))
    return window[0], window[1]
