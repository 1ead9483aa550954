"""FLIP of a textured mesh with decoded textures, in many views, for `texmesh_textures.py`."""

import time
from argparse import Namespace
from collections.abc import Container, Iterator, Sequence

import numpy as np

from farfield.addon.core.imaging.colors import LINEAR_OF_BYTE
from farfield.addon.core.imaging.flip import FlipImage, compare, filter_radius, prepare_image
from farfield.addon.core.imaging.mipmaps import Mipmaps, build_mipmaps
from farfield.addon.core.texmesh.perception.views import PlacedSamples, frame_around, place_samples, prepare_surface, render, shade
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

PIXELS_PER_DEGREE = 67.0
VIEWS = {256: 24, 512: 24, 1024: 8}  # random views by the size of the image in pixels
MAX_PLACED = 2  # meshes and sizes of textures whose samples are kept


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
        self._placed: dict[tuple, tuple[TexturedMesh, list[PlacedSamples]]] = {}
        surface = prepare_surface(mesh, [to_mipmaps(image) for image in images])
        for direction in directions:
            picture = render(surface, direction, self._frame, pixels)
            window = _find_window(picture.coverage)
            self._windows.append(window)
            self._coverages.append(picture.coverage[window])
            self._references.append(prepare_image(picture.colors[window], PIXELS_PER_DEGREE, is_linear=True))

    def measure_flip(self, images: Sequence[np.ndarray | None], mesh: TexturedMesh | None = None) -> float:
        """Return the mean FLIP error of the pixels of the object in all views, with another mesh if one is given."""
        textures = [to_mipmaps(image) for image in images]
        total, count = 0.0, 0
        placed = self._place(self._mesh if mesh is None else mesh, textures)
        for samples, window, coverage, reference in zip(placed, self._windows, self._coverages, self._references, strict=True):
            picture = shade(samples, textures)
            error = compare(reference, prepare_image(picture.colors[window], PIXELS_PER_DEGREE, is_linear=True))
            total += float(error[coverage].sum())
            count += int(coverage.sum())
        return total / count

    def _place(self, mesh: TexturedMesh, textures: Sequence[Mipmaps | None]) -> list[PlacedSamples]:
        """Return where the samples of all views are; those of the meshes before are kept."""
        key = id(mesh), *(None if texture is None else tuple(texture.sizes[0]) for texture in textures)
        found = self._placed.pop(key, None)
        if found is None:
            surface = prepare_surface(mesh, textures)
            found = mesh, [place_samples(surface, direction, self._frame, self._pixels) for direction in self._directions]
        self._placed[key] = found
        if len(self._placed) > MAX_PLACED:
            del self._placed[next(iter(self._placed))]
        return found[1]


def list_members(given: Namespace, names: Sequence[str]) -> Iterator[tuple[str, int]]:
    """Yield the names of models, those of `given` or else `names`, with each size of images, until the time of `given` is over."""
    end = time.monotonic() + 60.0 * given.minutes
    for name in given.models or names:
        for pixels in given.sizes:
            if time.monotonic() < end:
                yield name, pixels


def list_left_out(given: Namespace, names: Sequence[str], results: Container[str]) -> list[str]:
    """Return the members, "NAME at SIZE", for which there was no time."""
    members = [f"{name} at {pixels}" for name in given.models or names for pixels in given.sizes]
    return [member for member in members if member not in results]


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
