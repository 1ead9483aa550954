"""The hue of every texel, taken out before its colours are factorised: what is left tells of view and light, not of what it is made of."""

from collections.abc import Sequence

import numpy as np

from ..parallel import mapped
from ..progress import Progress, Steps
from .alternation import ViewData, by_light

LEAST = 1e-3  # of the mean over the channels: a channel darker than that would be blown up


def tints(views: Sequence[ViewData], rows: int, view_weights: np.ndarray, light_weights: np.ndarray) -> Steps[np.ndarray]:
    """Mean colours (N, 3) float32 of `rows` texels over all views and lights, each over its own mean channel; 1 where none is known.

    `views` have columns light by light, three channels each; `light_weights` (L,).
    """
    total = np.zeros((rows, 3))
    counting = light_weights.astype(np.float32)

    def summed(view: ViewData) -> tuple[np.ndarray, np.ndarray]:
        index, values = view.read()
        return index, counting @ by_light(values)

    for place, (index, part) in enumerate(mapped(summed, views)):
        yield Progress(place / len(views), "Taking out the hues")
        total[index] += view_weights[place] * part
    mean = total.mean(axis=1, keepdims=True)
    hue = np.where(mean > 0.0, total / np.where(mean > 0.0, mean, 1.0), 1.0)
    return np.maximum(hue, LEAST).astype(np.float32)
