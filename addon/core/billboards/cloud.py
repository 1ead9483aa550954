"""Data of a billboard cloud: per level the quads in space, the faces drawn on each, and their rectangles in a texture atlas."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

RECTANGLE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])  # A cutout that cuts nothing off.


@dataclass(frozen=True)
class Quads:
    """Q rectangles in world space and the primitives (triangles or points) that they replace.

    Attributes:
        centers: (Q, 3) float64.
        frames: (Q, 3, 3) float64, rows are the unit axes u, v and the normal n = u x v.
        half_sizes: (Q, 2) float64, along u and v.
        drawn_offsets: (Q + 1,) int32, quad q shows the primitives drawn[drawn_offsets[q]:drawn_offsets[q + 1]].
        drawn: (K,) int32, ascending per quad; a primitive may be drawn on several quads.
        owner: (P,) int32, the single quad that owns each primitive.
    """

    centers: np.ndarray
    frames: np.ndarray
    half_sizes: np.ndarray
    drawn_offsets: np.ndarray
    drawn: np.ndarray
    owner: np.ndarray

    def __len__(self) -> int:
        return len(self.centers)

    @property
    def areas(self) -> np.ndarray:
        """(Q,) areas of the rectangles, in squared units of length."""
        return 4.0 * self.half_sizes[:, 0] * self.half_sizes[:, 1]

    def corners(self) -> np.ndarray:
        """Return the corners (Q, 4, 3), counter-clockwise seen from the side of the normal, starting at (-u, -v)."""
        signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        offsets = signs[None] * self.half_sizes[:, None]
        return self.centers[:, None] + np.einsum("qci,qij->qcj", offsets, self.frames[:, :2])


@dataclass(frozen=True)
class AtlasLayout:
    """Layout of the quads in one texture.

    size: (width, height) in texels. rectangles (Q, 4) int32: x, y, width, height of the texels that belong to each quad, row 0 at the
    bottom; rectangles may touch. quad_sizes (Q, 2) int32: width and height of each quad in texels. It is centered in its rectangle, at
    least half a texel away from the sides; u runs along x, v along y.
    """

    size: tuple[int, int]
    rectangles: np.ndarray
    quad_sizes: np.ndarray

    @property
    def texel_count(self) -> int:
        """Number of texels in the quads."""
        return int(self.quad_sizes.astype(np.int64).prod(axis=1).sum())

    @cached_property
    def quad_map(self) -> np.ndarray:
        """Index (H, W) int32 of the quad to which each texel belongs; -1 for none."""
        quads = np.full(self.size[::-1], -1, np.int32)
        for quad, (x, y, width, height) in enumerate(self.rectangles):
            quads[y : y + height, x : x + width] = quad
        return quads


@dataclass(frozen=True)
class Chart:
    """A part of a mesh that is a height field over the plane of a quad.

    Attributes:
        vertices: (V, 3) float64 in space; those on a border are the same numbers in the charts on both sides.
        triangles: (T, 3) int32 into the vertices, counterclockwise seen from the front of the quad.
        normals: (V, 3) unit normals for shading, of the mesh on both sides of a border, but not beyond a crease.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray


@dataclass(frozen=True)
class Level:
    """One level of detail of a cloud.

    Attributes:
        error: A length in scene units.
        texel_size: Side length of a texel in scene units.
        quads: The quads.
        atlas: Layout of their textures.
        cutouts: (C, 2) polygon per quad, in -1..1 of its half sizes.
        joined: (Q,) bool, the quad shows part of a surface that continues on other quads; its textures are extended by one texel,
            so that no crack opens.
        solid: (Q,) bool, the quad shows only the outside of solids, whose inside no camera sees.
        charts: per quad the part of a mesh that is shown in its place, None for a flat polygon.
    """

    error: float
    texel_size: float
    quads: Quads
    atlas: AtlasLayout
    cutouts: list[np.ndarray]
    joined: np.ndarray
    solid: np.ndarray
    charts: list[Chart | None]

    @property
    def triangle_count(self) -> int:
        """Number of triangles of the cutouts and charts: a polygon of C corners has C - 2."""
        flat = sum(len(cutout) - 2 for cutout, chart in zip(self.cutouts, self.charts, strict=True) if chart is None)
        return flat + self.chart_triangle_count

    @property
    def chart_triangle_count(self) -> int:
        """Number of triangles of the charts."""
        return sum(len(chart.triangles) for chart in self.charts if chart is not None)

    @property
    def quad_count(self) -> int:
        """Number of quads for a budget: two triangles of charts count as one quad, and each chart as one at least."""
        chart_count = sum(chart is not None for chart in self.charts)
        return len(self.quads) - chart_count + max(chart_count, math.ceil(0.5 * self.chart_triangle_count))

    def to_cutout(self, quad: int, points: np.ndarray) -> np.ndarray:
        """Return where `points` (N, 3) in space lie on the plane of a quad, (N, 2) in its half sizes."""
        local = (points - self.quads.centers[quad]) @ self.quads.frames[quad, :2].T
        return local / np.maximum(self.quads.half_sizes[quad], np.finfo(float).tiny)

    @property
    def texel_count(self) -> int:
        """Number of texels inside the quads. A quad cut to a triangle counts half of its rectangle."""
        sizes = self.atlas.quad_sizes.astype(np.int64).prod(axis=1)
        triangular = np.array([len(cutout) == 3 for cutout in self.cutouts])
        return int(np.where(triangular, 0.5 * sizes, sizes).sum())


@dataclass(frozen=True)
class Cloud:
    """A billboard cloud and statistics of its construction.

    Attributes:
        levels: Finest first.
        source_triangles: Number of primitives of the source.
        dropped_triangles: Number of those without area.
        longest_side: Longest bounding-box side of the source.
        max_plane_distance: Maximum distance of a vertex to the plane of a quad that shows it, over the level's error.
        faces_beyond_normal_bound: Number of faces of the finest level beyond the normal bound of their owner.
        uncovered_faces: Number of faces that no quad shows.
        seconds: Run time per stage.
        notes: Sentences about decimated meshes of as many triangles, about levels that were left out, about a cloud that is no lighter than
            its source, and about what it leaves out of materials.
    """

    levels: list[Level]
    source_triangles: int
    dropped_triangles: int
    longest_side: float
    max_plane_distance: float
    faces_beyond_normal_bound: int
    uncovered_faces: int
    seconds: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
