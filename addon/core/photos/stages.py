"""Pictures of the stages of a merge (Textures Revisited, Figures 7 to 9): what is used of photographs, and where texels come from."""

import numpy as np

from ..imaging.images import sample_bilinear
from .photographs import Photograph
from .views import MIN_TRUST

MAX_SIDE = 800  # pixels of pictures of photographs
UNUSED_COLOR = np.array([0.9, 0.1, 0.1], np.float32)
UNUSED_OPACITY = 0.6
CLASS_COLORS = np.array([[0.0, 0.0, 0.0], [0.25, 0.65, 0.3], [0.2, 0.4, 0.85], [0.85, 0.2, 0.2]], np.float32)
UNCOVERED, PHOTOGRAPHED, INTERPOLATED, UNBOUND = range(4)


def draw_trust(photograph: Photograph, cells: np.ndarray) -> np.ndarray:
    """Return the photograph as a small picture (H, W, 3), red where its cells (h, w), evenly divided, or its mask say that it shows
    something else than the surface."""
    height, width = photograph.pixels.shape[:2]
    step = max(1, -(-max(height, width) // MAX_SIDE))
    area = (slice(step // 2, None, step),) * 2
    image = photograph.pixels[area].astype(np.float32)
    if photograph.pixels.dtype == np.uint8:
        image /= np.float32(255.0)
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    positions = np.stack([(columns.ravel() + 0.5) / image.shape[1], (rows.ravel() + 0.5) / image.shape[0]], axis=1)
    trust = sample_bilinear(cells[..., None], positions * cells.shape[::-1])[:, 0].reshape(image.shape[:2])
    is_unused = trust <= MIN_TRUST
    if photograph.mask is not None:
        is_unused |= ~photograph.mask[area]
    image[is_unused] += np.float32(UNUSED_OPACITY) * (UNUSED_COLOR - image[is_unused])
    return np.clip(image, 0.0, 1.0)


def classify_texels(triangles: np.ndarray, found: np.ndarray, corners: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """Return the class (N,) uint8 of each texel: UNCOVERED, PHOTOGRAPHED, INTERPOLATED between vertices that photographs show, or UNBOUND.

    Args:
        triangles: (N,) of the texels, -1 for none. found: (N,) bool, a photograph shows them. corners: (T, 3) vertices of the triangles.
        bound: (V,) bool, a photograph shows the vertex.
    """
    is_bound = np.append(bound[corners].all(axis=1), True)
    classes = np.where(is_bound[triangles], INTERPOLATED, UNBOUND).astype(np.uint8)
    classes[found] = PHOTOGRAPHED
    classes[triangles < 0] = UNCOVERED
    return classes
