"""The hue of every texel, taken out before its colours are factorised: what is left tells of view and light, not of what it is made of."""

from collections.abc import Sequence

import numpy as np

from ..progress import Progress, Steps
from .alternation import ViewData

LEAST = 1e-3  # of the mean over the channels: a channel darker than that would be blown up


def tints(views: Sequence[ViewData], rows: int, view_weights: np.ndarray, light_weights: np.ndarray) -> Steps[np.ndarray]:
    """Mean colours (N, 3) float32 of `rows` texels over all views and lights, each over its own mean channel; 1 where none is known.

    `views` have columns light by light, three channels each; `light_weights` (L,).
    """
    total = np.zeros((rows, 3))
    for place, view in enumerate(views):
        yield Progress(place / len(views), "Taking out the hues")
        index, values = view.read()
        total[index] += view_weights[place] * np.einsum("mlc,l->mc", values.reshape(len(index), -1, 3), light_weights)
    mean = total.mean(axis=1, keepdims=True)
    hue = np.where(mean > 0.0, total / np.where(mean > 0.0, mean, 1.0), 1.0)
    return np.maximum(hue, LEAST).astype(np.float32)
