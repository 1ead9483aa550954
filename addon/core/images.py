"""Images as arrays: filling what no surface covers, mips, and alpha.

Images are (H, W, C) float32, row 0 at the bottom, scene-linear where they are colours.
"""

import numpy as np
from scipy.ndimage import distance_transform_edt

EMPTY = 1e-6  # coverage below this counts as none: a colour divided by it would be noise


def unpremultiply(image: np.ndarray) -> np.ndarray:
    """Straight colours of a premultiplied `image` (H, W, 4); black where alpha is none. Alpha stays."""
    alpha = image[..., 3:]
    straight = image[..., :3] / np.where(alpha > EMPTY, alpha, 1.0) * (alpha > EMPTY)
    return np.concatenate([straight, alpha], axis=2)


def dilate(image: np.ndarray, known: np.ndarray, texels: int = 4) -> np.ndarray:
    """`image` (H, W, C) with a value in every texel: known ones stay, the others take theirs from the known ones around.

    known: (H, W) bool, or coverage 0..1 that counts as known above zero and weighs the neighbours. Up to `texels` texels away a value is
    the mean of its nearest known neighbours, so that no chart bleeds into the next within a gutter of twice that; farther out it comes
    from a pyramid (pull and push), so that every texel of every mip has a colour. An image with nothing known stays as it is.
    """
    weight = np.where(known > EMPTY, known, 0.0).astype(np.float32)[..., None]
    if not weight.any():
        return image
    filled = image * (weight > 0.0)
    for _ in range(texels):
        unknown = weight == 0.0
        if not unknown.any():
            return filled
        around = _sum_of_neighbours(np.concatenate([filled * weight, weight], axis=2))
        reached = unknown & (around[..., -1:] > 0.0)
        mean = around[..., :-1] / np.where(around[..., -1:] > 0.0, around[..., -1:], 1.0)
        filled = np.where(reached, mean, filled)
        weight = np.where(reached, np.minimum(around[..., -1:], 1.0), weight)
    return _pull_push(filled, weight)


def nearest_known(known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and column (H, W) of the nearest texel where `known` (H, W) bool holds, for what cannot be mixed as `dilate` does."""
    if not known.any():
        return tuple(np.indices(known.shape))
    return tuple(distance_transform_edt(~known, return_distances=False, return_indices=True))


def grow_outline(image: np.ndarray, where: np.ndarray, reach: int) -> np.ndarray:
    """Premultiplied `image` (H, W, 4) with its opaque parts grown by one texel within `where` (H, W) bool.

    Alpha becomes the largest of the texel and the four beside it; colours come from up to `reach` texels away.
    """
    alpha = image[..., 3]
    grown = np.where(where, np.maximum(alpha, largest_beside(alpha)), alpha)[..., None]
    straight = dilate(unpremultiply(image)[..., :3], alpha, reach)
    return np.concatenate([straight * grown, grown], axis=2)


def largest_beside(values: np.ndarray) -> np.ndarray:
    """The largest (H, W) of the four texels beside each of `values` (H, W); past the border there is 0."""
    padded = np.pad(values, 1)
    return np.max([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]], axis=0)


def mips(image: np.ndarray) -> list[np.ndarray]:
    """`image` (H, W, C) and its halves down to one texel, each texel the mean of the up to 2 x 2 it covers. Premultiply colours first."""
    chain = [image]
    while max(chain[-1].shape[:2]) > 1:
        chain.append(_half(chain[-1]))
    return chain


def preserve_coverage(alphas: list[np.ndarray], threshold: float = 0.5) -> list[np.ndarray]:
    """The mips `alphas` [(H, W), ...] of one alpha channel, scaled so that each passes an alpha test as often as the first.

    For cut-out (masked) alpha, after Castano 2010. Hashed and dithered alpha need none of it: the share of samples that pass is the mean
    of alpha, which `mips` keeps.
    """
    target = float((alphas[0] > threshold).mean())
    scaled = [alphas[0]]
    for alpha in alphas[1:]:
        if target <= 0.0 or not alpha.any():
            scaled.append(alpha)
            continue
        cut = max(float(np.sort(alpha, axis=None)[min(round((1.0 - target) * alpha.size), alpha.size - 1)]), EMPTY)
        # Texels of equal alpha pass together: with them or without, whichever is nearer.
        with_ties, without = float((alpha >= cut).mean()), float((alpha > cut).mean())
        beside = 1.0 + 1e-5 if abs(with_ties - target) <= abs(without - target) else 1.0 - 1e-5
        scaled.append(np.clip(alpha * (threshold / cut * beside), 0.0, 1.0).astype(alpha.dtype))
    return scaled


def bilinear(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """`image` (H, W, C) at `places` (M, 2), x and y in pixels from its lower left corner, between the middles of pixels; (M, C)."""
    limits = np.array(image.shape[1::-1]) - 1
    at = np.clip(places - 0.5, 0.0, limits)
    low = np.minimum(np.floor(at).astype(np.int64), np.maximum(limits - 1, 0))
    high = np.minimum(low + 1, limits)
    x, y = (at - low).T[..., None]
    lower = (1.0 - x) * image[low[:, 1], low[:, 0]] + x * image[low[:, 1], high[:, 0]]
    upper = (1.0 - x) * image[high[:, 1], low[:, 0]] + x * image[high[:, 1], high[:, 0]]
    return (1.0 - y) * lower + y * upper


def _sum_of_neighbours(image: np.ndarray) -> np.ndarray:
    """Sum over the 3 x 3 texels around each texel of `image` (H, W, C); nothing lies beyond the border."""
    rows = image.copy()
    rows[1:] += image[:-1]
    rows[:-1] += image[1:]
    total = rows.copy()
    total[:, 1:] += rows[:, :-1]
    total[:, :-1] += rows[:, 1:]
    return total


def _half(image: np.ndarray) -> np.ndarray:
    """Means over 2 x 2 texels; an odd last row or column stands for itself."""
    odd_rows, odd_columns = image.shape[0] % 2, image.shape[1] % 2
    even = np.pad(image, ((0, odd_rows), (0, odd_columns), (0, 0)), mode="edge")
    return 0.25 * (even[0::2, 0::2] + even[1::2, 0::2] + even[0::2, 1::2] + even[1::2, 1::2])


def _pull_push(image: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """`image` (H, W, C) with the texels of zero `weight` (H, W, 1) taken from ever coarser weighted means."""
    if weight.all() or max(image.shape[:2]) == 1:
        return image
    halved = _half(np.concatenate([image * weight, weight], axis=2))
    sums, coarse_weight = halved[..., :-1], halved[..., -1:]
    coarse = _pull_push(sums / np.where(coarse_weight > 0.0, coarse_weight, 1.0), coarse_weight)
    pushed = np.repeat(np.repeat(coarse, 2, axis=0), 2, axis=1)[: image.shape[0], : image.shape[1]]
    return np.where(weight > 0.0, image, pushed)
