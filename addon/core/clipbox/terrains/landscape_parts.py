"""Parts that landscapes are made of: warped noise, valleys, plateaus and layers of rock, with exact gradients."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .height_noise import Heights, sum_octaves

MORE, WARPS, GULLIES, BUMPS, LEDGES = 20, 40, 60, 80, 100  # Added to the seed, so that octaves of different noise are independent.

Noise = Callable[[np.ndarray, np.ndarray], Heights]


@dataclass(frozen=True)
class Shape:
    """What the settings say about a landscape.

    Attributes:
        seed: of its noise.
        ruggedness: factor of heights.
        erosion: factor of the depth of gullies.
    """

    seed: int
    ruggedness: float
    erosion: float


def warp(noise: Noise, x: np.ndarray, y: np.ndarray, spacing: float, wavelength: float, distance: float, seed: int) -> Heights:
    """Return noise at positions that other noise has moved, which warps ridges and valleys."""
    along_x, along_y = (sum_octaves(x, y, spacing, wavelength, 2, seed + 8 * axis).scale(distance) for axis in (0, 1))
    warped = noise(x + along_x.height, y + along_y.height)
    gradient_x = warped.gradient_x * (1.0 + along_x.gradient_x) + warped.gradient_y * along_y.gradient_x
    gradient_y = warped.gradient_x * along_x.gradient_y + warped.gradient_y * (1.0 + along_y.gradient_y)
    return Heights(warped.height, gradient_x, gradient_y)


def cut(places: Heights, width: float) -> Heights:
    """Return 1 where `places` is 0, falling to 0 on both sides within `width`, with steep walls."""
    t = places.height / np.float32(width)
    value = np.exp(-(t**4))
    return places.map(value, -4.0 * t**3 * value / np.float32(width))


def rise(places: Heights, center: float, width: float) -> Heights:
    """Return 0 where `places` are far below `center` and 1 far above, with an S-curve between."""
    value = 0.5 + 0.5 * np.tanh((places.height - np.float32(center)) / np.float32(width))
    return places.map(value, np.float32(2.0 / width) * value * (1.0 - value))


def add_layers(ground: Heights, thickness: float, hardness: float) -> Heights:
    """Return ground with ledges: layers of a thickness, of which each has a steep and a level part. hardness: from 0 to 1."""
    phase = ground.height * np.float32(2.0 * np.pi / thickness)
    step = ground.height - np.float32(hardness * thickness / (2.0 * np.pi)) * np.sin(phase)
    return ground.map(step, 1.0 - np.float32(hardness) * np.cos(phase))
