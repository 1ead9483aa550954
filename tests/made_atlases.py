"""Relightable textures of random numbers, for the tests of what reads and writes them."""

import numpy as np

from farfield.addon.core.btf.decoding import BakedAtlas
from farfield.addon.core.btf.factors import Factors
from farfield.addon.core.btf.lobes import Lobes, Surface
from farfield.addon.core.btf.lpca import LocalFactors
from farfield.addon.core.direction_grids import DirectionGrid
from farfield.addon.core.directions import fibonacci_sphere

VIEWS, LIGHTS = DirectionGrid(4), DirectionGrid(3, upper=True)


def made_colour(rows: int, clusters: int = 1, components: int = 5, views: int = len(VIEWS), lights: int = len(LIGHTS)) -> Factors:
    """Factors of colours; with several clusters, local ones."""
    random = np.random.default_rng(clusters)
    weights = random.random((rows, components), np.float32)
    basis = random.normal(size=(views, clusters * components, 3 * (lights + 1))).astype(np.float32)
    known = np.ones(rows, bool)
    if clusters == 1:
        return Factors(weights, basis, known)
    return LocalFactors(weights, basis, known, random.integers(clusters, size=rows).astype(np.int32))


def made_lobes(rows: int, roughness: float = 0.3) -> Lobes:
    """Lobes of texels that look all ways."""
    random = np.random.default_rng(2)
    surface = Surface(fibonacci_sphere(rows).astype(np.float32), np.full(rows, roughness, np.float32))
    return Lobes(surface, *(random.uniform(0.0, 0.5, shape).astype(np.float32) for shape in ((rows, 3), (rows, 3), rows)))


def made_atlas(size: tuple[int, int] = (7, 4), clusters: int = 1, lobes: bool = False) -> BakedAtlas:
    """An atlas of views all around and lights from above."""
    random = np.random.default_rng(9)
    rows = size[0] * size[1]
    alpha = Factors(random.random((rows, 2), np.float32), random.normal(size=(len(VIEWS), 2, 1)).astype(np.float32), np.ones(rows, bool))
    tints = random.uniform(0.5, 1.5, (rows, 3)).astype(np.float32)
    plain = random.random(rows, np.float32)
    return BakedAtlas(size, tints, made_colour(rows, clusters), alpha, plain, VIEWS, LIGHTS, made_lobes(rows) if lobes else None)


def decoded(atlas: BakedAtlas, view: np.ndarray, light: np.ndarray) -> np.ndarray:
    """What the arrays say of a view (3,) under a light (3,): (H, W, 3)."""
    return atlas.picture(atlas.seen_from(view[None], light[None])[0, :, 0], view, light)
