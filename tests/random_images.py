"""Small random images and masks, for campaigns and tests."""

from random import Random

import numpy as np

DTYPES = (np.uint8, np.uint8, np.uint16, np.float16, np.float32)
SPECIAL_VALUES = (np.nan, np.inf, -np.inf, -1.0, 1e30, 6e-8)


def random_image(random: Random) -> np.ndarray:
    """Return an array (H, W, C) as it is stored in a file, of 1 to 4 channels: noise, a gradient or one value, sometimes with holes in its
    alpha, or values that are not finite."""
    generator = np.random.default_rng(random.getrandbits(32))
    height, width = (random.choice((random.choice((1, 3, 7)), *(random.randint(20, 60) for _ in range(4)))) for _ in range(2))
    dtype, channels = np.dtype(random.choice(DTYPES)), random.randint(1, 4)
    kind = random.randrange(3)
    if kind == 0:
        values = generator.random((height, width, channels))
    elif kind == 1:
        values = np.broadcast_to(np.linspace(0.0, 1.0, width)[:, None], (height, width, channels)).copy()
    else:
        values = np.full((height, width, channels), random.choice((0.0, 0.5, 1.0)))
    if channels in (2, 4) and random.random() < 0.5:
        values[..., -1] = random_mask(random, (height, width)) == 0
    if dtype.kind == "u":
        return np.rint(values * np.iinfo(dtype).max).astype(dtype)
    values *= random.choice((1.0, 1.0, 20.0))
    with np.errstate(over="ignore"):  # half floats
        if random.random() < 0.2:
            values[generator.integers(height), generator.integers(width)] = random.choice(SPECIAL_VALUES)
        return values.astype(dtype)


def random_mask(random: Random, size: tuple[int, int]) -> np.ndarray:
    """Return a mask (H, W) uint8 of 0 and 255: rectangles, single pixels, nothing or everything."""
    generator = np.random.default_rng(random.getrandbits(32))
    choice = random.random()
    if choice < 0.1:
        return np.full(size, random.choice((0, 255)), np.uint8)
    if choice < 0.25:
        return np.where(generator.random(size) < 0.05, 255, 0).astype(np.uint8)
    mask = np.zeros(size, np.uint8)
    for _ in range(random.randint(1, 3)):
        row, column = (int(generator.integers(side)) for side in size)
        mask[row : row + random.randint(1, 8), column : column + random.randint(1, 8)] = 255
    return mask
