"""Inputs of `bench_restore.py`: textures of many kinds, and smooth intensity gradients.

Images are (H, W, 3) float32 sRGB values in 0..1, row 0 at the bottom. Generated textures differ with the random
generator that they get. Photographs are read by the process of the peers, which has decoders of PNG and JPEG.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from restore_noise import cell_noise, colorize, fractal_noise, smooth_noise
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

SIZE = 400  # pixels per side
JITTER = 16  # pixels by which crops of photographs move between runs
Generator = np.random.Generator
Texture = Callable[[Generator, tuple[int, int]], np.ndarray]


class Crop(NamedTuple):
    """A part of a photograph: its file, the upper left corner (row from the top, column) and the size (height, width) in pixels."""

    file: str
    corner: tuple[int, int]
    size: tuple[int, int] = (SIZE, SIZE)


PHOTOGRAPHS = {  # From scikit-image, 512 x 512 and gray, and from the Sceaux castle.
    "brick": Crop("skimage:brick.png", (56, 56)),
    "grass": Crop("skimage:grass.png", (56, 56)),
    "gravel": Crop("skimage:gravel.png", (56, 56)),
    "sceaux wall": Crop("00008.jpg", (420, 980)),
    "sceaux facade": Crop("00004.jpg", (390, 440)),
    "sceaux roof": Crop("00001.jpg", (235, 500), (300, 400)),
    "sceaux sky": Crop("00001.jpg", (140, 60)),
    "sceaux foliage": Crop("00009.jpg", (16, 1050), (350, 350)),
    "sceaux lawn": Crop("00002.jpg", (760, 720), (280, 400)),
}


def marble(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return veined, colored stone: stripes bent by fractal noise."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    angle, period = random.uniform(0.0, np.pi), random.uniform(35.0, 60.0)
    phase = (np.cos(angle) * x + np.sin(angle) * y) / period + 1.3 * fractal_noise(random, shape, 60.0, 1.0)
    return colorize(random, 0.5 + 0.5 * np.sin(2.0 * np.pi * phase) + 0.12 * fractal_noise(random, shape, 6.0, 0.6))


def fractal(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return fractal noise."""
    return colorize(random, 0.5 + 0.22 * fractal_noise(random, shape, random.uniform(16.0, 40.0), random.uniform(0.6, 1.0)))


def granite(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return colored stone: grains with a color each, and fine noise."""
    nearest, second, index = cell_noise(random, shape, random.uniform(6.0, 10.0))
    colors = np.clip(random.uniform(0.35, 0.7, 3) + random.normal(scale=0.12, size=(int(index.max()) + 1, 1)), 0.05, 0.95)
    grains = colors[index] * np.clip(0.6 + 0.25 * (second - nearest), 0.0, 1.0)[..., None]
    return np.clip(grains + 0.03 * random.standard_normal(shape)[..., None], 0.0, 1.0).astype(np.float32)


def cells(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return Worley noise: cells that are darker towards their edges."""
    nearest, second, _ = cell_noise(random, shape, random.uniform(14.0, 24.0))
    return colorize(random, np.clip((second - nearest) / 14.0, 0.0, 1.0))


def pebbles(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return rounded stones, lit from one side, of different brightness."""
    nearest, second, index = cell_noise(random, shape, random.uniform(16.0, 26.0))
    height = gaussian_filter(np.sqrt(np.clip((second - nearest) / 12.0, 0.0, 1.0)), 1.2)
    gradient = np.gradient(height)
    angle = random.uniform(0.0, 2.0 * np.pi)
    light = 0.5 + 1.8 * (np.cos(angle) * gradient[0] + np.sin(angle) * gradient[1])
    albedo = random.uniform(0.5, 1.0, int(index.max()) + 1)[index]
    return colorize(random, np.clip(light * albedo * (0.35 + 0.65 * height) + 0.03 * random.standard_normal(shape), 0.0, 1.0))


def canvas(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return a plain weave: threads over and under, of uneven thickness."""
    return weave(random, shape, over=1)


def twill(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return a twill weave: threads that pass over two others."""
    return weave(random, shape, over=2)


def weave(random: Generator, shape: tuple[int, int], over: int) -> np.ndarray:
    """Return woven threads; each passes over `over` threads and then under as many."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    pitch = random.uniform(9.0, 14.0)
    column = (x + 1.2 * fractal_noise(random, shape, 50.0, 1.0)) / pitch
    row = (y + 1.2 * fractal_noise(random, shape, 50.0, 1.0)) / pitch
    is_warp = (np.floor(column) + np.floor(row)) % (2 * over) < over
    across, along = np.where(is_warp, column, row) % 1.0 - 0.5, np.where(is_warp, row, column) % 1.0 - 0.5
    ridge = np.sqrt(np.clip(1.0 - (1.9 * across) ** 2, 0.0, 1.0)) * (1.0 - 0.5 * (2.0 * along) ** 2 / over)
    fibers = 0.08 * gaussian_filter(random.standard_normal(shape), 0.7)
    return colorize(random, np.clip(0.15 + 0.65 * ridge * np.where(is_warp, 1.0, 0.8) + fibers, 0.0, 1.0))


def masonry(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return a wall of bricks with an uneven bond and a color per brick."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    height, width = random.uniform(18.0, 26.0), random.uniform(42.0, 60.0)
    y, x = y + 0.8 * smooth_noise(random, shape, 20.0), x + 0.8 * smooth_noise(random, shape, 20.0)
    row = np.floor(y / height).astype(int)
    shifts = 0.5 * (np.arange(row.max() - row.min() + 1) % 2) + random.uniform(-0.08, 0.08, row.max() - row.min() + 1)
    along = x / width + shifts[row - row.min()]
    column = np.floor(along).astype(int)
    tones = random.uniform(0.55, 1.0, (row.max() - row.min() + 1, column.max() - column.min() + 1))
    edge = np.minimum(np.minimum(y % height, -y % height), np.minimum(along % 1.0, -along % 1.0) * width)
    brick = np.array([0.62, 0.32, 0.24]) * random.uniform(0.8, 1.2, 3)
    faces = brick * tones[row - row.min(), column - column.min(), None] * (1.0 + 0.12 * fractal_noise(random, shape, 5.0, 0.5)[..., None])
    mortar = np.clip((edge - 1.5) / 1.5, 0.0, 1.0)[..., None]
    return np.clip(mortar * faces + (1.0 - mortar) * random.uniform(0.6, 0.75), 0.0, 1.0).astype(np.float32)


def checker(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return a checkerboard with uneven edges, rotated."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    angle, pitch = random.uniform(0.0, np.pi), random.uniform(15.0, 26.0)
    first = np.cos(angle) * x + np.sin(angle) * y + 1.5 * smooth_noise(random, shape, 12.0)
    second = np.cos(angle) * y - np.sin(angle) * x + 1.5 * smooth_noise(random, shape, 12.0)
    is_bright = gaussian_filter(((np.floor(first / pitch) + np.floor(second / pitch)) % 2.0), 0.8)
    return colorize(random, np.clip(0.15 + 0.6 * is_bright + 0.08 * fractal_noise(random, shape, 4.0, 0.3), 0.0, 1.0))


def wood(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return a wooden board: stretched growth rings and fibers."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    center, stretch = random.uniform(-0.5, 0.5) * shape[1], random.uniform(4.0, 7.0)
    rings = np.hypot(x - shape[1] / 2.0 - center, (y + 600.0) / stretch) / random.uniform(7.0, 11.0)
    rings += 0.7 * gaussian_filter(random.standard_normal(shape), (40.0, 10.0)) / gaussian_deviation(40.0, 10.0)
    fibers = gaussian_filter(random.standard_normal(shape), (9.0, 0.6)) / gaussian_deviation(9.0, 0.6)
    tone = 0.55 + 0.25 * (rings % 1.0) ** 2 + 0.05 * fibers
    return np.clip(tone[..., None] * np.array([1.0, 0.72, 0.47]), 0.0, 1.0).astype(np.float32)


def speckle(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return blurred noise without any larger pattern, with a color per grain."""
    sigma = random.uniform(0.8, 1.6)
    noise = np.stack([gaussian_filter(random.standard_normal(shape), sigma) for _ in range(3)], axis=-1) / gaussian_deviation(sigma, sigma)
    return np.clip(random.uniform(0.4, 0.6, 3) + 0.1 * noise + 0.06 * noise[..., :1], 0.0, 1.0).astype(np.float32)


def stripes(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return bent stripes of two widths."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    angle, period = random.uniform(0.0, np.pi), random.uniform(18.0, 30.0)
    across = (np.cos(angle) * x + np.sin(angle) * y) / period + 0.25 * fractal_noise(random, shape, 90.0, 1.2)
    tone = 0.4 * (across % 1.0 < 0.5) + 0.25 * ((across * 3.0) % 1.0 < 0.3)
    return colorize(random, np.clip(gaussian_filter(tone, 0.8) + 0.2 + 0.05 * fractal_noise(random, shape, 5.0, 0.4), 0.0, 1.0))


def leaves(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return fallen leaves: ellipses that cover each other, with a midrib and a color each."""
    image, size = np.zeros((*shape, 3), np.float32), random.uniform(9.0, 15.0)
    mean_color = random.uniform(0.2, 0.7, 3)
    for _ in range(int(5.0 * shape[0] * shape[1] / size**2)):
        row, column, angle = random.uniform(-size, shape[0] + size), random.uniform(-size, shape[1] + size), random.uniform(0.0, np.pi)
        length, width = size * random.uniform(0.7, 1.4), size * random.uniform(0.3, 0.5)
        top, bottom = np.clip([int(row - length), int(row + length) + 2], 0, shape[0])
        left, right = np.clip([int(column - length), int(column + length) + 2], 0, shape[1])
        y, x = np.mgrid[top:bottom, left:right]
        along = np.cos(angle) * (x - column) + np.sin(angle) * (y - row)
        across = np.cos(angle) * (y - row) - np.sin(angle) * (x - column)
        inside = (along / length) ** 2 + (across / width) ** 2 < 1.0
        tone = random.uniform(0.5, 1.1) * (0.75 + 0.35 * np.minimum(np.abs(across) / width, 1.0))
        color = np.clip(mean_color + random.normal(scale=0.06, size=3), 0.05, 0.9)
        image[top:bottom, left:right][inside] = (tone[..., None] * color)[inside]
    return np.clip(gaussian_filter(image, (0.5, 0.5, 0.0)), 0.0, 1.0)


def sand(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return fine grains with weak ripples."""
    grains = gaussian_filter(random.standard_normal(shape), 0.6) / gaussian_deviation(0.6, 0.6)
    spots = gaussian_filter(random.standard_normal(shape), 1.8) / gaussian_deviation(1.8, 1.8)
    ripples = gaussian_filter(random.standard_normal(shape), (12.0, 5.0)) / gaussian_deviation(12.0, 5.0)
    tone = 0.6 + random.uniform(0.06, 0.1) * grains + 0.05 * spots + random.uniform(0.0, 0.05) * ripples
    return np.clip(tone[..., None] * random.uniform([0.85, 0.7, 0.5], [1.0, 0.9, 0.75]), 0.0, 1.0).astype(np.float32)


def hexagons(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return hexagonal tiles of two colors with joints, each of its own brightness."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    pitch, angle = random.uniform(18.0, 28.0), random.uniform(0.0, np.pi)
    first, second = (np.cos(angle) * x + np.sin(angle) * y) / pitch, (np.cos(angle) * y - np.sin(angle) * x) / pitch
    first, second = first - first.min() + 2.0, second - second.min() + 2.0
    step = np.sqrt(0.75)
    centers = np.array(
        [(column + 0.5 * (row % 2), row * step) for row in range(int(second.max() / step) + 3) for column in range(int(first.max()) + 3)]
    )
    distances, index = cKDTree(centers).query(np.stack([first, second], axis=-1), k=2)
    tones = random.choice(random.uniform(0.3, 0.8, 2), len(centers)) * random.uniform(0.85, 1.1, len(centers))
    joint = np.clip((distances[..., 1] - distances[..., 0]) / 0.1, 0.0, 1.0)
    return colorize(random, np.clip(0.2 + joint * (tones[index[..., 0]] - 0.2) + 0.04 * fractal_noise(random, shape, 6.0, 0.5), 0.0, 1.0))


def rust(random: Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return flaking paint: ragged patches of two materials, each with a grain of its own."""
    field = fractal_noise(random, shape, random.uniform(20.0, 40.0), 0.9)
    is_rust = np.clip((field + 0.2) / 0.15, 0.0, 1.0)[..., None]
    paint = random.uniform(0.35, 0.85, 3) * (1.0 + 0.04 * fractal_noise(random, shape, 5.0, 0.4))[..., None]
    metal = np.array([0.45, 0.25, 0.14]) * (1.0 + 0.3 * fractal_noise(random, shape, 8.0, 0.5))[..., None]
    return np.clip(is_rust * metal + (1.0 - is_rust) * paint, 0.0, 1.0).astype(np.float32)


GENERATED: dict[str, Texture] = {
    generate.__name__: generate
    for generate in (
        marble,
        fractal,
        granite,
        cells,
        pebbles,
        canvas,
        twill,
        masonry,
        checker,
        wood,
        speckle,
        stripes,
        leaves,
        sand,
        hexagons,
        rust,
    )
}
TUNING = (
    "gravel",
    "sceaux roof",
    "marble",
    "twill",
    "brick",
    "grass",
    "leaves",
    "sand",
    "hexagons",
    "rust",
)  # settings may be tuned on these only
TEXTURES = {
    "tuning": TUNING,
    "judging": tuple(name for name in (*PHOTOGRAPHS, *GENERATED) if name not in TUNING),
}


def gaussian_deviation(*sigmas: float) -> float:
    """Return the standard deviation of white noise of deviation 1 after a Gaussian filter with these sigmas, one per axis."""
    return float(np.prod([1.0 / np.sqrt(2.0 * np.sqrt(np.pi) * sigma) for sigma in sigmas]))


def crop(photograph: np.ndarray, area: Crop, random: Generator) -> np.ndarray:
    """Return an area of `photograph` (H, W, C), moved by up to JITTER pixels but within the photograph."""
    top, left = (
        int(np.clip(corner + random.integers(-JITTER, JITTER + 1), 0, side - length))
        for corner, side, length in zip(area.corner, photograph.shape[:2], area.size, strict=True)
    )
    bottom = photograph.shape[0] - top - area.size[0]  # row 0 of an array is at the bottom
    return photograph[bottom : bottom + area.size[0], left : left + area.size[1]]


def add_gradient(image: np.ndarray, random: Generator, *, multiply: bool) -> np.ndarray:
    """Return `image` under a smooth gradient of intensity, which darkens it or is added to it. No value is clipped."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    angle = random.uniform(0.0, 2.0 * np.pi)
    ramp = np.cos(angle) * x / image.shape[1] + np.sin(angle) * y / image.shape[0]
    ramp += 0.15 * smooth_noise(random, image.shape[:2], max(image.shape) / 4.0)
    ramp = ((ramp - ramp.min()) / (ramp.max() - ramp.min()))[..., None]
    graded = image * (0.3 + 0.7 * ramp) if multiply else 0.5 * image + 0.5 * ramp
    return graded.astype(np.float32)
