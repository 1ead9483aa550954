"""Noises that the textures of `bench_restore.py` are generated from."""

import numpy as np
from scipy.ndimage import gaussian_filter, zoom
from scipy.spatial import cKDTree


def smooth_noise(random: np.random.Generator, shape: tuple[int, int], size: float) -> np.ndarray:
    """Return noise (H, W) of mean 0 and deviation 1 with features of about `size` pixels."""
    step = max(int(size / 8.0), 1)  # drawn coarsely and enlarged, so that large features cost no more than small ones
    noise = gaussian_filter(random.standard_normal([side // step + 2 for side in shape] if step > 1 else shape), 0.5 * size / step)
    if step > 1:
        noise = zoom(noise, step, order=3)[: shape[0], : shape[1]]
    return (noise - noise.mean()) / noise.std()


def fractal_noise(random: np.random.Generator, shape: tuple[int, int], size: float, decay: float) -> np.ndarray:
    """Return noise (H, W) of mean 0 and deviation 1: octaves from `size` pixels down to one, each weaker by the factor 2^-decay."""
    total, weight = np.zeros(shape), 1.0
    while size >= 1.0:
        total += weight * smooth_noise(random, shape, size)
        size, weight = 0.5 * size, weight * 0.5**decay
    return total / total.std()


def cell_noise(random: np.random.Generator, shape: tuple[int, int], pitch: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Worley noise of points about `pitch` pixels apart: distances (H, W) to the nearest and the second point, and the index of the
    nearest point (H, W)."""
    rows, columns = (int(side / pitch) + 4 for side in shape)
    grid = np.stack(np.mgrid[:rows, :columns], axis=-1).reshape(-1, 2) - 2.0
    tree = cKDTree((grid + random.uniform(0.1, 0.9, grid.shape)) * pitch)
    pixels = np.stack(np.mgrid[: shape[0], : shape[1]], axis=-1).reshape(-1, 2)
    distances, indices = tree.query(pixels, k=2)
    return distances[:, 0].reshape(shape), distances[:, 1].reshape(shape), indices[:, 0].reshape(shape)


def colorize(random: np.random.Generator, values: np.ndarray) -> np.ndarray:
    """Return colors (H, W, 3) float32 of `values` (H, W): a ramp through three random colors, dark to bright."""
    brightness = np.array([[0.12], [0.5], [0.88]])
    colors = np.clip(brightness + random.uniform(-0.12, 0.12, (3, 3)), 0.0, 1.0)
    positions = np.clip(values, 0.0, 1.0)
    return np.stack([np.interp(positions, [0.0, 0.5, 1.0], colors[:, channel]) for channel in range(3)], axis=-1).astype(np.float32)
