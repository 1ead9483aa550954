"""What matters on a surface: how many texels each triangle should get beside the others, from 0 for the fewest to 1 for the most."""

import numpy as np

from ..errors import SettingsError

WELL_SEEN = 95.0  # per cent of what is seen get no more pixels than what counts as most important


def from_direction(normals: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Importance (T,) of triangles with unit `normals` (T, 3) for a viewer far off in `direction` (3,): all that faces it matters alike.

    Raises:
        SettingsError: when the direction has no length or is not finite.
    """
    return (normals @ _unit(direction) > 0.0).astype(np.float64)


def from_look(normals: np.ndarray, direction: np.ndarray, ratio: float) -> np.ndarray:
    """Importance (T,) as the paper has it, weights 1 / (<N, V> + k) with V along the look (section 3.2): what is turned to the viewer
    matters more the more it is. k is such that the largest weight is the least times `ratio` squared.

    Raises:
        SettingsError: when the direction has no length or is not finite.
    """
    towards = normals @ _unit(direction)
    if ratio <= 1.0:
        return np.zeros(len(normals))
    k = (ratio**2 + 1.0) / (ratio**2 - 1.0)
    return np.clip(np.log((k + 1.0) / (k - towards)) / np.log(ratio**2), 0.0, 1.0)


def from_pixels(pixels: np.ndarray, areas: np.ndarray, ratio: float) -> np.ndarray:
    """Importance (T,) of triangles with `areas` (T,) that show `pixels` (T,): texels are to follow pixels within a factor `ratio`."""
    density = np.divide(pixels, areas, out=np.zeros(len(areas)), where=areas > 0.0)
    seen = density > 0.0
    if not seen.any() or ratio <= 1.0:
        return np.zeros(len(areas))
    order = np.argsort(density)
    ranks = np.cumsum(np.where(seen, areas, 0.0)[order])
    most = density[order][np.searchsorted(ranks, 0.01 * WELL_SEEN * ranks[-1])]
    return np.where(seen, np.clip(1.0 + np.log(np.where(seen, density, 1.0) / most) / np.log(ratio), 0.0, 1.0), 0.0)


def _unit(direction: np.ndarray) -> np.ndarray:
    direction = np.asarray(direction, np.float64)
    length = float(np.linalg.norm(direction))
    if not np.isfinite(length) or length == 0.0:
        raise SettingsError("The direction of importance has no length; give one that points from the surface to the viewer.")
    return direction / length
