"""Relightable textures of random numbers, for the tests of their readers and writers."""

import numpy as np

from farfield.addon.core.btf.decoding import RelightableTexture
from farfield.addon.core.btf.factorization.factors import Factors
from farfield.addon.core.btf.factorization.lpca import LocalFactors
from farfield.addon.core.btf.reflectance.lobes import Lobes, TexelSurface
from farfield.addon.core.geometry.directions import DirectionGrid, fibonacci_sphere

VIEWS, LIGHTS = DirectionGrid(4), DirectionGrid(3, upper=True)


def random_color_factors(
    row_count: int, clusters: int = 1, components: int = 5, views: int = len(VIEWS), lights: int = len(LIGHTS)
) -> Factors:
    """Return random color factors; `LocalFactors` if there are several clusters."""
    random = np.random.default_rng(clusters)
    weights = random.random((row_count, components), np.float32)
    basis = random.normal(size=(views, clusters * components, 3 * (lights + 1))).astype(np.float32)
    known = np.ones(row_count, bool)
    if clusters == 1:
        return Factors(weights, basis, known)
    return LocalFactors(weights, basis, known, random.integers(clusters, size=row_count).astype(np.int32))


def random_lobes(row_count: int, roughness: float = 0.3) -> Lobes:
    """Return random lobes of texels with normals in all directions."""
    random = np.random.default_rng(2)
    surface = TexelSurface(fibonacci_sphere(row_count).astype(np.float32), np.full(row_count, roughness, np.float32))
    shapes = ((row_count, 3), (row_count, 3), row_count)
    return Lobes(surface, *(random.uniform(0.0, 0.5, shape).astype(np.float32) for shape in shapes))


def random_texture(size: tuple[int, int] = (7, 4), clusters: int = 1, lobes: bool = False) -> RelightableTexture:
    """Return a random texture with views in all directions and lights above the horizon."""
    random = np.random.default_rng(9)
    count = size[0] * size[1]
    alpha = Factors(random.random((count, 2), np.float32), random.normal(size=(len(VIEWS), 2, 1)).astype(np.float32), np.ones(count, bool))
    chromaticity = random.uniform(0.5, 1.5, (count, 3)).astype(np.float32)
    pbr_alpha = random.random(count, np.float32)
    color = random_color_factors(count, clusters)
    return RelightableTexture(size, chromaticity, color, alpha, pbr_alpha, VIEWS, LIGHTS, random_lobes(count) if lobes else None)


def decode_radiance(texture: RelightableTexture, view: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Decode the radiance (H, W, 3) from a view (3,) under a light (3,)."""
    return texture.radiance(texture.interpolate_basis(view[None], light[None])[0, :, 0], view, light)
