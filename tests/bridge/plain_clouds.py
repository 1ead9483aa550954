"""Billboard clouds made the plainest way, to test the bridge without the search for planes."""

import numpy as np

from farfield.addon.core.billboards.cloud import Atlas, Cloud, Level, Quads
from farfield.addon.core.mesh import TriangleMesh, face_areas_and_normals, longest_side

GUTTER = 4


def six_directions() -> np.ndarray:
    """The directions of the axes, both ways (6, 3)."""
    return np.concatenate([np.eye(3), -np.eye(3)])


def spread_directions(count: int) -> np.ndarray:
    """Unit vectors (count, 3) on a Fibonacci spiral."""
    steps = np.arange(count) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * steps / count), np.pi * (1.0 + 5.0**0.5) * steps
    return np.column_stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)])


def cloud_of_directions(mesh: TriangleMesh, directions: np.ndarray, texel: float, joined: bool = False) -> Cloud:
    """One level with a quad for each of `directions` (D, 3) that some face of the convex `mesh` looks into most.

    Its quads are taken as pieces of one closed surface if they are `joined`, else as what they are alone.
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
    pieces = np.full(len(quads), joined)
    level = Level(error, texel, quads, _shelf(half_sizes, texel), [square] * len(quads), joined=pieces, solid=pieces)
    return Cloud([level], len(mesh.triangles), 0, longest_side(mesh.vertices), 1.0, 0, 0)


def _rectangle(points: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Centre, frame, half sizes and half height of the box around `points` (N, 3) along `normal`."""
    across = np.cross([0.0, 0.0, 1.0] if abs(normal[2]) < 0.9 else [1.0, 0.0, 0.0], normal)
    across /= np.linalg.norm(across)
    frame = np.stack([across, np.cross(normal, across), normal])
    local = points @ frame.T
    low, high = local.min(axis=0), local.max(axis=0)
    return 0.5 * (low + high) @ frame, frame, np.maximum(0.5 * (high - low)[:2], 1e-9), 0.5 * (high - low)[2]


def _shelf(half_sizes: np.ndarray, texel: float) -> Atlas:
    """Rectangles side by side in rows of about equal length."""
    sizes = np.ceil(2.0 * half_sizes / texel - 1e-9).astype(int).clip(1)
    row = int(np.sqrt(((sizes + GUTTER).prod(axis=1)).sum()) + sizes[:, 0].max())
    x, y, height, places = GUTTER, GUTTER, 0, []
    for width, tall in sizes:
        if x + width + GUTTER > row + 2 * GUTTER:
            x, y, height = GUTTER, y + height + GUTTER, 0
        places.append((x, y, width, tall))
        x, height = x + width + GUTTER, max(height, tall)
    rectangles = np.array(places, np.int32)
    ends = (rectangles[:, :2] + rectangles[:, 2:]).max(axis=0) + GUTTER
    return Atlas((int(ends[0]), int(ends[1])), rectangles, GUTTER)
