"""Masks of `bench_restore.py`: (H, W) bool, row 0 at the bottom, in three shapes."""

import numpy as np
from scipy.ndimage import distance_transform_edt

Generator = np.random.Generator


def blob(random: Generator, shape: tuple[int, int], fraction: float = 0.05) -> np.ndarray:
    """Return a mask with one smooth hole of about `fraction` of the pixels."""
    radius = np.sqrt(fraction * shape[0] * shape[1] / np.pi)
    y, x = np.mgrid[: shape[0], : shape[1]]
    reach = min(1.4 * radius, 0.45 * min(shape))
    row, column = (random.uniform(reach, side - reach) for side in shape)
    angle, outline = np.arctan2(y - row, x - column), np.ones(shape)
    for order in range(2, 6):
        outline += random.uniform(0.0, 0.4 / order) * np.cos(order * angle + random.uniform(0.0, 2.0 * np.pi))
    distance = np.hypot(y - row, x - column) / outline
    return distance <= np.partition(distance.ravel(), int(fraction * distance.size))[int(fraction * distance.size)]


def strokes(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return a mask with four thick, bent scratches."""
    far = np.ones(shape, bool)
    time = np.linspace(0.0, 1.0, 4 * max(shape))[:, None]
    distance = np.full(shape, np.inf)
    for _ in range(4):
        first, control, last = random.uniform(0.05, 0.95, (3, 2)) * shape
        points = (1.0 - time) ** 2 * first + 2.0 * time * (1.0 - time) * control + time**2 * last
        row, column = np.rint(points).astype(int).T
        far[:] = True
        far[row, column] = False
        distance = np.minimum(distance, distance_transform_edt(far) / random.uniform(0.01, 0.016))
    return distance <= min(shape)


def rectangles_and_text(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return a mask with six small rectangles and a line of letters."""
    from farfield.addon.bridge.overlays.line_chart import rasterize_text

    mask = np.zeros(shape, bool)
    letters = rasterize_text("".join(random.permutation(list("FARFIELD"))), shape[0] // 6)[::-1] > 0.5
    letters = letters[:, : shape[1] - 20]
    row, column = (random.integers(5, side - length - 4) for side, length in zip(shape, letters.shape, strict=True))
    mask[row : row + letters.shape[0], column : column + letters.shape[1]] = letters
    for _ in range(6):
        height, width = random.integers(min(shape) // 30, min(shape) // 12, 2)
        row, column = random.integers(0, shape[0] - height), random.integers(0, shape[1] - width)
        mask[row : row + height, column : column + width] = True
    return mask


def scatter_holes(random: Generator, shape: tuple[int, int], count: int, pixels: float) -> np.ndarray:
    """Return a mask with `count` smooth holes of different sizes that do not touch, together about `pixels` pixels."""
    mask = np.zeros(shape, bool)
    areas = random.uniform(0.3, 1.7, count)
    for area in sorted(areas * pixels / areas.sum(), reverse=True):
        side = int(3.0 * np.sqrt(area / np.pi)) + 2
        hole = blob(random, (side, side), area / side**2)
        while True:
            row, column = (random.integers(0, length - side) for length in shape)
            window = mask[max(row - 1, 0) : row + side + 1, max(column - 1, 0) : column + side + 1]
            if not window.any():
                break
        mask[row : row + side, column : column + side] = hole
    return mask


MASKS = {"blob": blob, "strokes": strokes, "text": rectangles_and_text}
