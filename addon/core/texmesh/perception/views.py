"""Renders of textured meshes from all around, as small as they appear from a distance (section IV.A: all silhouettes are examined).

Views are orthographic: from where levels switch, objects are small in the visual field. A render has more samples than the images that
`resize_by_area` makes of it, so that silhouettes are antialiased at every size.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...imaging.mipmaps import Mipmaps, measure_footprints, sample_mipmaps
from ...imaging.raster import draw_ids, list_drawn
from ..corner_normals import find_corner_normals
from ..textured_mesh import TexturedMesh

PLAIN_COLOR = 0.6  # linear, of materials without a texture
AMBIENT = 0.25  # fraction of the color that shows without the headlight
BACKGROUND = 0.214  # linear; middle gray as displayed
MIN_LENGTH = np.float32(1e-6)  # Length of an interpolated normal; opposite ones cancel.
FRAME_MARGIN = 1.04  # side of an image relative to the diameter of the object


@dataclass(frozen=True, eq=False)
class ViewedSurface:
    """What renders need of a mesh, prepared once for all views.

    Attributes:
        vertices: (V, 3) float64.
        triangles: (T, 3) int32.
        corner_uvs: (T, 3, 2) float64.
        corner_normals: (T, 3, 3) float32, None for renders without light.
        materials: (T,) int32 into textures.
        textures: mipmaps with three channels, or None.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    corner_uvs: np.ndarray
    corner_normals: np.ndarray | None
    materials: np.ndarray
    textures: Sequence[Mipmaps | None]


@dataclass(frozen=True)
class Frame:
    """The square that all views of an object show: its center (3,) and its side, in the object's space and unit."""

    center: np.ndarray
    side: float


@dataclass(frozen=True, eq=False)
class Render:
    """A square image of a surface: colors (S, S, 3) float32, linear, over BACKGROUND, and coverage (S, S) bool."""

    colors: np.ndarray
    coverage: np.ndarray


def prepare_surface(
    mesh: TexturedMesh, textures: Sequence[Mipmaps | None], is_lit: bool = True, fine: TexturedMesh | None = None
) -> ViewedSurface:
    """Return `mesh` prepared for renders.

    Args:
        textures: for each material its base color, linear, or None. Levels of one object share them.
        is_lit: shade with a headlight, so that the shape of the surface counts, see `find_corner_normals`.
        fine: the mesh that `mesh` is a level of, None for none.
    """
    corner_normals = find_corner_normals(mesh, fine) if is_lit else None
    return ViewedSurface(mesh.vertices, mesh.triangles, mesh.corner_uvs, corner_normals, mesh.materials, textures)


def frame_around(vertices: np.ndarray) -> Frame:
    """Return the frame that contains `vertices` (V, 3) in every view."""
    center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    radius = float(np.linalg.norm(vertices - center, axis=1).max())
    return Frame(center, 2.0 * FRAME_MARGIN * radius)


def view_axes(direction: np.ndarray) -> np.ndarray:
    """Return the axes (3, 3) of an image seen from `direction` (3,): rows are right, up, and towards the viewer; z is up in the image."""
    right = np.cross([0.0, 0.0, 1.0], direction)
    length = np.linalg.norm(right)
    right = right / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.stack([right, np.cross(direction, right), direction])


def render(surface: ViewedSurface, direction: np.ndarray, frame: Frame, size: int) -> Render:
    """Return an image of `surface`, seen from `direction` (3,) without perspective, with `size` x `size` samples of the frame.

    Textures are sampled trilinearly by footprint. With normals, a headlight shines from the viewer on both sides of faces.
    """
    return shade(place_samples(surface, direction, frame, size), surface.textures)


@dataclass(frozen=True, eq=False)
class TextureSamples:
    """The covered samples of an image that show one texture.

    material: its index. rows: (N,) among the covered samples, or all of them. uvs: (N, 2) float32. footprints: (N,) float64, in texels.
    """

    material: int
    rows: np.ndarray | slice
    uvs: np.ndarray
    footprints: np.ndarray


@dataclass(frozen=True, eq=False)
class PlacedSamples:
    """Where the samples of an image are on a surface: all that renders with different textures of the same sizes have in common.

    coverage: (S, S) bool. parts: by texture. facing: (N,) float32 cosines of all covered samples to the viewer, None without light.
    """

    coverage: np.ndarray
    parts: tuple[TextureSamples, ...]
    facing: np.ndarray | None


def place_samples(surface: ViewedSurface, direction: np.ndarray, frame: Frame, size: int) -> PlacedSamples:
    """Return where the samples of an image are, see `render`."""
    axes = view_axes(direction)
    positions = (surface.vertices - frame.center) @ axes.T
    corners = ((positions[:, :2] / frame.side + 0.5) * size)[surface.triangles]
    depths = 4.0 * frame.side - positions[:, 2]
    owners, _ = draw_ids(corners, depths[surface.triangles], (size, size))
    coverage = owners >= 0
    samples = np.flatnonzero(coverage)
    shown, rows = list_drawn(owners.ravel()[samples], len(corners))
    located = _Samples(rows, _find_barycentric(corners[shown], rows, samples, size))
    parts = _divide_by_texture(surface, corners[shown], shown, located)
    facing = None
    if surface.corner_normals is not None:
        facing = _measure_facing(surface.corner_normals[shown], axes[2].astype(np.float32), located)
    return PlacedSamples(coverage, tuple(parts), facing)


def shade(placed: PlacedSamples, textures: Sequence[Mipmaps | None]) -> Render:
    """Return the image of placed samples with `textures`, which have the sizes of those that they were placed with."""
    samples = np.flatnonzero(placed.coverage)
    colors = np.full((len(samples), 3), PLAIN_COLOR, np.float32)
    for part in placed.parts:
        colors[part.rows] = sample_mipmaps(textures[part.material], part.uvs, part.footprints)
    if placed.facing is not None:
        colors *= (AMBIENT + (1.0 - AMBIENT) * placed.facing)[:, None]
    image = np.full((placed.coverage.size, 3), BACKGROUND, np.float32)
    image[samples] = colors
    return Render(image.reshape(*placed.coverage.shape, 3), placed.coverage)


@dataclass(frozen=True, eq=False)
class _Samples:
    """Covered samples of an image: rows (N,) int32 of the triangles that are shown, and barycentric coordinates, three (N,) float32."""

    rows: np.ndarray
    barycentric: tuple[np.ndarray, np.ndarray, np.ndarray]

    def interpolate(self, corner_values: np.ndarray) -> np.ndarray:
        """Return `corner_values` (T, 3) at the samples, (N,)."""
        first, second, third = corner_values.astype(np.float32).T.copy()
        result = first.take(self.rows) * self.barycentric[0]
        result += second.take(self.rows) * self.barycentric[1]
        result += third.take(self.rows) * self.barycentric[2]
        return result


def _find_barycentric(corners: np.ndarray, rows: np.ndarray, samples: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return barycentric coordinates, three (N,) float32, none negative, of `samples` (N,), indices in an image `size` wide, in the
    triangles `rows` (N,) of `corners` (T, 3, 2)."""
    origin = corners[:, 0]
    (first_x, first_y), (second_x, second_y) = (corners[:, 1] - origin).T, (corners[:, 2] - origin).T
    scale = 1.0 / (first_x * second_y - first_y * second_x)
    lines, columns = np.divmod(samples, size)
    x = columns + 0.5
    x -= origin[:, 0].take(rows)
    y = lines + 0.5
    y -= origin[:, 1].take(rows)
    second = (second_y * scale).take(rows) * x
    second -= (second_x * scale).take(rows) * y
    third = (first_x * scale).take(rows) * y
    third -= (first_y * scale).take(rows) * x
    second, third = (np.clip(values, 0.0, 1.0).astype(np.float32) for values in (second, third))
    return np.maximum(1.0 - second - third, 0.0), second, third


def _measure_facing(corner_normals: np.ndarray, direction: np.ndarray, located: _Samples) -> np.ndarray:
    """Return the cosines (N,) float32 between the interpolated `corner_normals` (T, 3, 3), unit vectors, and `direction` (3,)."""
    along = located.interpolate(corner_normals @ direction)
    first, second, third = located.barycentric
    squares = first * first + second * second + third * third
    for corner, following, product in ((0, 1, first * second), (1, 2, second * third), (2, 0, third * first)):
        cosines = np.einsum("tc,tc->t", corner_normals[:, corner], corner_normals[:, following])
        squares += 2.0 * cosines.take(located.rows) * product
    return np.abs(along) / np.sqrt(np.maximum(squares, MIN_LENGTH**2))


def _divide_by_texture(surface: ViewedSurface, corners: np.ndarray, shown: np.ndarray, located: _Samples) -> Iterator[TextureSamples]:
    """Yield the samples of each texture. corners: (T, 3, 2) of the triangles `shown` (T,)."""
    corner_uvs, materials = surface.corner_uvs[shown], surface.materials[shown]
    for material, texture in enumerate(surface.textures):
        if texture is None:
            continue
        of_material = materials == material
        samples = slice(None) if of_material.all() else np.flatnonzero(of_material.take(located.rows))
        part = _Samples(located.rows[samples], tuple(values[samples] for values in located.barycentric))
        if not len(part.rows):
            continue
        footprints = measure_footprints(corners, corner_uvs, tuple(texture.sizes[0]))
        uvs = np.stack([part.interpolate(corner_uvs[:, :, axis]) for axis in range(2)], axis=1)
        yield TextureSamples(material, samples, uvs, footprints.take(part.rows))
