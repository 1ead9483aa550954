"""Images as arrays: alpha, filling uncovered texels, bilinear sampling.

Images are (H, W, C) float32, row 0 at the bottom; colors are scene-linear.
"""

import numpy as np
from scipy.ndimage import distance_transform_edt

STRIP_ROWS = 256  # Rows that are reduced at once; even.
NEIGHBORS = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column]
MIN_ALPHA = 1e-6  # coverage below this counts as zero: a color divided by it would be noise


def to_bytes(values: np.ndarray) -> np.ndarray:
    """Return values of 0 to 1, of any shape, as uint8 of 0 to 255."""
    return np.rint(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)


def unpremultiply(image: np.ndarray) -> np.ndarray:
    """Return a premultiplied `image` (H, W, 4) with straight colors, black where alpha is zero. Alpha is unchanged."""
    alpha = image[..., 3:]
    straight = image[..., :3] / np.where(alpha > MIN_ALPHA, alpha, 1.0) * (alpha > MIN_ALPHA)
    return np.concatenate([straight, alpha], axis=2)


def mean_over_coverage(image: np.ndarray, radius: int = 4, maximum: float = 1.0, regions: np.ndarray | None = None) -> np.ndarray:
    """Return the straight values (H, W, 3) of a premultiplied `image` (H, W, 4), clamped to 0..maximum.

    Texels without coverage are filled from their neighbors, in the same one of the `regions`, see `dilate`.
    """
    coverage = image[..., 3]
    mean = image[..., :3] / np.maximum(coverage, MIN_ALPHA)[..., None]
    return dilate(np.clip(mean, 0.0, maximum), coverage, radius, regions)


def dilate(image: np.ndarray, known: np.ndarray, radius: int = 4, regions: np.ndarray | None = None) -> np.ndarray:
    """Return `image` (H, W, C) with a value in every texel: known texels stay, the others are filled from the known ones around them.

    known: (H, W) bool, or coverage 0..1, which counts as known above zero and weights the neighbors. Up to `radius` texels away a value is
    the mean of its nearest known neighbors, so that no chart bleeds into the next within a gutter of twice that. Farther away it comes
    from an image pyramid (pull-push), so that every texel of every mipmap level has a color. An image with nothing known is unchanged.
    regions: (H, W) int, texels count as neighbors only within the same region, so that charts may touch.
    """
    filled = np.where((known > MIN_ALPHA)[..., None], image, image.dtype.type(0.0)) if (known > MIN_ALPHA).any() else image
    dilate_in_place(filled, known, radius, regions)
    return filled


def dilate_in_place(image: np.ndarray, known: np.ndarray, radius: int = 4, regions: np.ndarray | None = None) -> None:
    """Do what `dilate` does to an `image` (H, W, C) that is contiguous; it needs little more memory than a channel."""
    height, width, channels = image.shape
    weight = known.astype(np.float32)
    weight[weight <= MIN_ALPHA] = 0.0
    if not weight.any():
        return
    flat, weights = image.reshape(-1, channels), weight.reshape(-1)
    for _ in range(radius):
        is_known = weight > 0.0
        rows, columns = np.nonzero(~is_known & _any_of_neighbors(is_known))
        if not len(rows):
            break
        sums, totals = np.zeros((len(rows), channels), image.dtype), np.zeros(len(rows), np.float32)
        for row_step, column_step in NEIGHBORS:
            row, column = rows + row_step, columns + column_step
            inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            neighbors = np.clip(row, 0, height - 1) * width + np.clip(column, 0, width - 1)
            weight_there = weights[neighbors] * inside
            if regions is not None:
                weight_there *= regions.reshape(-1)[neighbors] == regions[rows, columns]
            sums += weight_there[:, None] * flat[neighbors]
            totals += weight_there
        is_filled = totals > 0.0
        filled = (rows * width + columns)[is_filled]
        flat[filled] = sums[is_filled] / totals[is_filled, None]
        weights[filled] = np.minimum(totals[is_filled], 1.0)
    _pull_push(image, weight[..., None])


def nearest_known(known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return row and column (H, W) of the nearest texel where `known` (H, W) bool is set, for values that must not be averaged."""
    if not known.any():
        return tuple(np.indices(known.shape))
    return tuple(distance_transform_edt(~known, return_distances=False, return_indices=True))


def grow_silhouette(image: np.ndarray, allowed: np.ndarray, regions: np.ndarray) -> np.ndarray:
    """Grow the opaque parts of a premultiplied `image` (H, W, 4) by one texel where `allowed` (H, W) bool, within `regions` (H, W) int.

    Alpha becomes the maximum of the texel and its four neighbors; colors come from the known texels around it, see `dilate`.
    """
    alpha = image[..., 3]
    grown = np.where(allowed, np.maximum(alpha, max_of_neighbors(alpha, regions)), alpha)[..., None]
    straight = dilate(unpremultiply(image)[..., :3], alpha, regions=regions)
    return np.concatenate([straight * grown, grown], axis=2)


def max_of_neighbors(values: np.ndarray, regions: np.ndarray) -> np.ndarray:
    """Return the maximum (H, W) of the four neighbors of each of `values` (H, W) in the same one of `regions` (H, W) int, at least 0."""
    result = np.zeros_like(values)
    for lower, upper in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        is_same = regions[lower] == regions[upper]
        result[lower] = np.maximum(result[lower], values[upper] * is_same)
        result[upper] = np.maximum(result[upper], values[lower] * is_same)
    return result


def sample_bilinear(image: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Sample `image` (H, W, C) at `positions` (M, 2), x and y in pixels from its lower left corner, bilinearly between pixel centers:
    (M, C)."""
    limits = np.array(image.shape[1::-1]) - 1
    clamped = np.clip(positions - 0.5, 0.0, limits)
    low = np.minimum(np.floor(clamped).astype(np.int64), np.maximum(limits - 1, 0))
    high = np.minimum(low + 1, limits)
    x, y = (clamped - low).T[..., None]
    flat, width = image.reshape(-1, image.shape[2]), image.shape[1]
    lower_rows, upper_rows = low[:, 1] * width, high[:, 1] * width
    lower = (1.0 - x) * np.take(flat, lower_rows + low[:, 0], axis=0) + x * np.take(flat, lower_rows + high[:, 0], axis=0)
    upper = (1.0 - x) * np.take(flat, upper_rows + low[:, 0], axis=0) + x * np.take(flat, upper_rows + high[:, 0], axis=0)
    return (1.0 - y) * lower + y * upper


def decode_normals(pixels: np.ndarray) -> np.ndarray:
    """Return the unit normals (N, 3) that the `pixels` (N, 3 or more) of a normal map encode; +Z where a pixel encodes none."""
    normals = 2.0 * pixels[:, :3] - 1.0
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(lengths > 1e-6, normals / np.maximum(lengths, 1e-6), np.float32([0.0, 0.0, 1.0]))


def _any_of_neighbors(values: np.ndarray) -> np.ndarray:
    """Return whether one of the 3 x 3 texels around each texel of `values` (H, W) bool is set."""
    rows = values.copy()
    rows[1:] |= values[:-1]
    rows[:-1] |= values[1:]
    result = rows.copy()
    result[:, 1:] |= rows[:, :-1]
    result[:, :-1] |= rows[:, 1:]
    return result


def _half(image: np.ndarray) -> np.ndarray:
    """Return the means over 2 x 2 texels; an odd last row or column is repeated."""
    odd_rows, odd_columns = image.shape[0] % 2, image.shape[1] % 2
    even = np.pad(image, ((0, odd_rows), (0, odd_columns), (0, 0)), mode="edge")
    return 0.25 * (even[0::2, 0::2] + even[1::2, 0::2] + even[0::2, 1::2] + even[1::2, 1::2])


def _pull_push(image: np.ndarray, weight: np.ndarray) -> None:
    """Fill the texels of a contiguous `image` (H, W, C) that have zero `weight` (H, W, 1) from coarser and coarser weighted means."""
    if weight.all() or max(weight.shape) == 1:
        return
    strips = [slice(start, start + STRIP_ROWS) for start in range(0, len(image), STRIP_ROWS)]
    halved = np.concatenate([_half(np.concatenate([image[strip] * weight[strip], weight[strip]], axis=2)) for strip in strips])
    coarse_weight = np.ascontiguousarray(halved[..., -1:])
    coarse = halved[..., :-1] / np.where(coarse_weight > 0.0, coarse_weight, 1.0)
    del halved
    _pull_push(coarse, coarse_weight)
    for strip in strips:
        rows, columns, _ = np.nonzero(weight[strip] == 0.0)
        image[strip][rows, columns] = coarse[strip.start // 2 + rows // 2, columns // 2]
