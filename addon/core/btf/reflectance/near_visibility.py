"""Near visibility: how much of the light that its quad receives the surface in a texel receives.

A loose quad shows all leaves within one error of its plane, so they no longer shade each other, and a crown would get too bright. So the
color of a texel is darkened by the ratio of two irradiances under a uniform sky: that of the source, which the views of the bake show, and
that of the cloud, for which the same views are directions of light.
"""

from collections.abc import Callable

import numpy as np

from ...arrays import TINY
from ...jobs.chunks import map_ordered
from ...jobs.progress import Progress, Steps
from ..refinement.fragments import Fragments
from ..refinement.refine import lookup_matrix

PRIOR = 0.3  # Irradiance with the mean ratio that is added to both: the irradiance of a texel is noisy, and a ratio even more so.
SCALING_STEPS = 10  # Until the mean is right, although no value exceeds 1.

Weighted = tuple[np.ndarray, np.ndarray]


def fit_near_visibility(
    view_count: int, read_source: Callable[[int], Weighted], read_cloud: Callable[[int], Weighted]
) -> Steps[np.ndarray]:
    """Return the near visibility (S, N) float32 of the S sides of N texels, 0 to 1; 1 where it is unknown.

    read_source, read_cloud: return for a view the irradiance (S, N) of source and cloud times a weight, and this weight (S, N).
    """

    def read(view: int) -> np.ndarray:
        return np.array([*read_source(view), *read_cloud(view)])

    totals = read(0)
    for view, sums in enumerate(map_ordered(read, range(1, view_count))):
        yield Progress(view / view_count, "Fitting near visibility")
        totals += sums
    (source, cloud), weights = totals[::2], totals[1::2]
    is_known = (weights > 0.0).all(axis=0)
    source, cloud = source[is_known] / weights[0][is_known], cloud[is_known] / weights[1][is_known]
    visibility = np.ones(is_known.shape, np.float32)
    visibility[is_known] = _darken(source, cloud, weights[0][is_known])
    return visibility


def _darken(source: np.ndarray, cloud: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the ratios (M,) of `source` to `cloud`, at most 1 and with the right `weights`-weighted mean, as far as that is below 1."""
    mean = float(weights @ source) / max(float(weights @ cloud), TINY)
    if mean >= 1.0:
        return np.ones_like(source)
    ratio = (source + PRIOR * mean) / (cloud + PRIOR)
    for _ in range(SCALING_STEPS):
        ratio = ratio * (mean * float(weights @ cloud) / max(float((weights * cloud) @ np.minimum(ratio, 1.0)), TINY))
    return np.minimum(ratio, 1.0)


def receive_light(fragments: Fragments, blocked: np.ndarray) -> Weighted:
    """Return the fraction (N,) of a light that N texels receive through the quads in front of them, times a weight, and this weight (N,).

    fragments: of the view from the light. blocked (N,): fraction of the light that a texel blocks.
    """
    lookup = lookup_matrix(fragments, len(blocked))
    transmittance = fragments.transmittance(np.clip(lookup @ blocked.astype(np.float32), 0.0, 1.0))
    return lookup.T @ transmittance, np.asarray(lookup.sum(axis=0)).ravel()
