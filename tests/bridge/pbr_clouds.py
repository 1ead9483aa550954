"""Simple billboard clouds, to test the bridge without the search for planes."""

import numpy as np

from farfield.addon.core.billboards.cloud import AtlasLayout, Cloud, Level, Quads
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals, longest_side

BORDER = 2


def axis_directions() -> np.ndarray:
    """Return the positive and negative axis directions (6, 3)."""
    return np.concatenate([np.eye(3), -np.eye(3)])


def spiral_directions(count: int) -> np.ndarray:
    """Return unit vectors (count, 3) on a Fibonacci spiral."""
    steps = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1.0 - 2.0 * steps / count), np.pi * (1.0 + 5.0**0.5) * steps
    return np.column_stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


def cloud_of_directions(mesh: TriangleMesh, directions: np.ndarray, texel: float, joined: bool = False) -> Cloud:
    """Return one level with a quad for each of `directions` (D, 3) that is the nearest direction of a face of the convex `mesh`.

    If `joined`, the quads count as parts of one closed surface, otherwise as separate quads.
    """
    normals = face_areas_and_normals(mesh.corners)[1]
    owner = np.argmax(normals @ directions.T, axis=1)
    groups = [np.flatnonzero(owner == index) for index in np.unique(owner)]
    fits = [_rectangle(mesh.corners[group].reshape(-1, 3), directions[owner[group[0]]]) for group in groups]
    centers, frames, half_sizes, heights = (np.stack(values) for values in zip(*fits, strict=True))
    quads = Quads(
        centers=centers,
        frames=frames,
        half_sizes=half_sizes,
        drawn_offsets=np.cumsum([0] + [len(group) for group in groups]).astype(np.int32),
        drawn=np.concatenate(groups).astype(np.int32),
        owner=np.unique(owner, return_inverse=True)[1].astype(np.int32),
    )
    error = max(float(heights.max()), 1e-3 * longest_side(mesh.vertices))
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    flags = np.full(len(quads), joined)
    level = Level(
        error, texel, quads, _shelf(half_sizes, texel), [square] * len(quads), joined=flags, solid=flags, charts=[None] * len(quads)
    )
    return Cloud([level], len(mesh.triangles), 0, longest_side(mesh.vertices), 1.0, 0, 0)


def _rectangle(points: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return center, frame, half sizes and half height of the box around `points` (N, 3) along `normal`."""
    u = np.cross([0.0, 0.0, 1.0] if abs(normal[2]) < 0.9 else [1.0, 0.0, 0.0], normal)
    u /= np.linalg.norm(u)
    frame = np.stack([u, np.cross(normal, u), normal])
    local = points @ frame.T
    low, high = local.min(axis=0), local.max(axis=0)
    return 0.5 * (low + high) @ frame, frame, np.maximum(0.5 * (high - low)[:2], 1e-9), 0.5 * (high - low)[2]


def _shelf(half_sizes: np.ndarray, texel: float) -> AtlasLayout:
    """Place rectangles with a border of two texels side by side in rows of about equal length."""
    sizes = np.ceil(2.0 * half_sizes / texel - 1e-9).astype(int).clip(1)
    row_length = int(np.sqrt(((sizes + 2 * BORDER).prod(axis=1)).sum()) + sizes[:, 0].max() + 2 * BORDER)
    x, y, row_height, placed = 0, 0, 0, []
    for width, height in sizes + 2 * BORDER:
        if x + width > row_length:
            x, y, row_height = 0, y + row_height, 0
        placed.append((x, y, width, height))
        x, row_height = x + width, max(row_height, height)
    rectangles = np.array(placed, np.int32)
    ends = (rectangles[:, :2] + rectangles[:, 2:]).max(axis=0)
    return AtlasLayout((int(ends[0]), int(ends[1])), rectangles, sizes.astype(np.int32))


def quad_corners(atlas: AtlasLayout) -> np.ndarray:
    """Return the texels (Q, 2) at the lower left corners of the quads, for sizes that differ from their rectangles' by an even number."""
    return atlas.rectangles[:, :2] + (atlas.rectangles[:, 2:] - atlas.quad_sizes) // 2
