"""Analytic reflectance model of a texel: a diffuse and a specular lobe.

A highlight is narrower than the direction grid of a bake, and at another place for every texel. A few components cannot represent it and
would spread it as a veil. So lobes are fitted first, and only the residual is factorized. The diffuse lobe is Lambertian. The specular lobe
is GGX with Smith masking (Walter et al. 2007); its Fresnel term, after Schlick, has separate reflectance at normal and grazing incidence.
"""

from dataclasses import dataclass

import numpy as np

from .disc_lights import DiscLights
from .parallax import ParallaxMap
from .shadows import Shadows

MIN_ROUGHNESS = 0.05
MIN_COSINE = 1e-3  # Between normal and view.
MIN_FRESNEL_COSINE = 0.2  # The Fresnel term is constant below: a quad shows texels that a smooth surface would hide.
DIFFUSE, SPECULAR, GRAZING = range(3)  # Coefficients of the model.
LOBE_COUNT = 3
ALL = slice(None)
CHUNK_TEXELS = 1024  # Processed at once, so that intermediate arrays stay in the CPU cache.


@dataclass(frozen=True)
class GrazingFresnel:
    """Shape of the Fresnel term: strength * (1 - cosine)^power, constant where the cosine is below MIN_FRESNEL_COSINE."""

    strength: float
    power: float

    def __call__(self, cosines: np.ndarray) -> np.ndarray:
        """Evaluate the term at `cosines`, between view and normal or half vector."""
        return self.strength * (1.0 - np.clip(cosines, MIN_FRESNEL_COSINE, 1.0)) ** self.power


SCHLICK = GrazingFresnel(1.0, 5.0)


@dataclass(frozen=True)
class TexelSurface:
    """Surface of N texels in the PBR maps.

    normals (N, 3): unit, object space. roughness (N,): as in a Principled BSDF. parallax: offsets of the normal lookup at oblique views;
    None for no offsets.
    """

    normals: np.ndarray
    roughness: np.ndarray
    parallax: ParallaxMap | None = None

    def normals_facing(self, view: np.ndarray, rows: slice | np.ndarray = ALL) -> np.ndarray:
        """Return the normals (M, 3) of `rows` as seen from the unit direction `view` (3,), flipped towards the viewer."""
        normals = self.normals[rows] if self.parallax is None else self.parallax.sample_normals(view, rows)
        return normals * np.where(normals @ view < 0.0, -1.0, 1.0)[:, None]


@dataclass(frozen=True)
class Lobes:
    """Lobes of N texels, float32, all in 0..1.

    Attributes:
        surface: Normals and roughness.
        diffuse: (N, 3) albedo.
        f0: (N, 3) specular reflectance at normal incidence.
        f90_minus_f0: (N,) added reflectance at grazing incidence.
        shadows: Visibility of suns; None without self-shadowing.
        sky_visibility: (N,) reflected fraction of a dome, including interreflection; None for 1.
        dome_fresnel: Scales `f90_minus_f0` under a dome.
    """

    surface: TexelSurface
    diffuse: np.ndarray
    f0: np.ndarray
    f90_minus_f0: np.ndarray
    shadows: Shadows | None = None
    sky_visibility: np.ndarray | None = None
    dome_fresnel: GrazingFresnel = SCHLICK

    @property
    def nbytes(self) -> int:
        """Size as half floats, roughness included. The normals belong to the PBR maps."""
        map_values = self.diffuse.size + self.f0.size + 2 * len(self.f90_minus_f0)
        map_values += 0 if self.sky_visibility is None else len(self.sky_visibility)
        return 2 * map_values + (0 if self.shadows is None else self.shadows.nbytes)

    def radiance_on_grid(self, view: np.ndarray, suns: DiscLights, rows: np.ndarray) -> np.ndarray:
        """Return the radiance (M, L + 1, 3) of `rows` (M,) from the unit direction `view` under each of the L `suns`, and under the dome.

        The visibility of the suns is that of `suns`, not of `shadows`.
        """
        radiance = np.empty((len(rows), len(suns.directions) + 1, 3), np.float32)
        for start in range(0, len(rows), CHUNK_TEXELS):
            chunk = rows[start : start + CHUNK_TEXELS]
            responses = lobe_responses(self.surface, view, suns, chunk)
            radiance[start : start + CHUNK_TEXELS, :-1] = responses[:, :-1] @ self._coefficients(chunk)
            radiance[start : start + CHUNK_TEXELS, -1] = self.radiance_under_dome(view, chunk)
        return radiance

    def radiance_under_lights(self, lights: np.ndarray, view: np.ndarray, suns: DiscLights, rows: np.ndarray) -> np.ndarray:
        """Return the radiance (W, M * 3) float16 of `rows` (W,) from `view` under `lights` (L + 1, M), weights of the suns and the dome."""
        radiance = np.empty((len(rows), lights.shape[1] * 3), np.float16)
        sun_weights, dome_weights = lights[:-1].T.astype(np.float32), lights[-1].astype(np.float32)
        for start in range(0, len(rows), CHUNK_TEXELS):
            chunk = rows[start : start + CHUNK_TEXELS]
            responses = lobe_responses(self.surface, view, suns, chunk)
            from_suns = np.matmul(sun_weights, responses[:, :-1]) @ self._coefficients(chunk)
            from_dome = dome_weights[:, None] * self.radiance_under_dome(view, chunk)[:, None]
            radiance[start : start + CHUNK_TEXELS] = (from_suns + from_dome).reshape(len(chunk), -1)
        return radiance

    def radiance_under_suns(self, view: np.ndarray, lights: np.ndarray, rows: slice = ALL) -> np.ndarray:
        """Return the radiance (M, L, 3) of `rows` from `view` (3,) under point-like suns of unit irradiance in the unit directions
        `lights` (L, 3)."""
        normals = self.surface.normals_facing(view, rows)
        specular, grazing = specular_lobe(normals, view, lights, self.surface.roughness[rows])
        diffuse = np.maximum(normals @ lights.T, 0.0) / np.pi
        radiance = diffuse[..., None] * self.diffuse[rows, None] + specular[..., None] * self.f0[rows, None]
        radiance += (grazing * self.f90_minus_f0[rows, None])[..., None]
        return radiance if self.shadows is None else radiance * self.shadows.visibility(lights, rows)[..., None]

    def radiance_under_dome(self, view: np.ndarray, rows: slice | np.ndarray = ALL) -> np.ndarray:
        """Return the radiance (M, 3) of `rows` from `view` under a dome of radiance 1."""
        grazing = self.dome_fresnel(self.surface.normals_facing(view, rows) @ view)
        radiance = self.diffuse[rows] + self.f0[rows] + (grazing * self.f90_minus_f0[rows])[:, None]
        return radiance if self.sky_visibility is None else radiance * self.sky_visibility[rows, None]

    def _coefficients(self, rows: np.ndarray) -> np.ndarray:
        """Return the coefficients (M, LOBE_COUNT, 3) of the lobe responses."""
        return np.stack([self.diffuse[rows], self.f0[rows], np.repeat(self.f90_minus_f0[rows, None], 3, axis=1)], axis=1)


def specular_lobe(normals: np.ndarray, view: np.ndarray, lights: np.ndarray, roughness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return GGX times cosine (N, L) for unit irradiance, without and with Schlick's factor (1 - h v)^5, see `GrazingFresnel`.

    normals (N, 3): facing `view` (3,); lights (L, 3); all unit. roughness (N,): its square is the alpha of GGX.
    """
    view_cosine, light_cosine = np.clip(normals @ view, MIN_COSINE, 1.0)[:, None], np.maximum(normals @ lights.T, 0.0)
    half = lights + view
    half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-6)
    alpha = np.maximum(roughness, MIN_ROUGHNESS)[:, None] ** 4
    denominator = (normals @ half.T) ** 2 * (alpha - 1.0) + 1.0
    smith_masking = light_cosine * np.sqrt(view_cosine**2 * (1.0 - alpha) + alpha)
    smith_masking = smith_masking + view_cosine * np.sqrt(light_cosine**2 * (1.0 - alpha) + alpha)
    specular = 0.5 * alpha * light_cosine / (np.pi * denominator**2 * np.maximum(smith_masking, 1e-6))
    return specular, specular * SCHLICK(half @ view)


def lobe_responses(surface: TexelSurface, view: np.ndarray, suns: DiscLights, rows: np.ndarray, count: int = LOBE_COUNT) -> np.ndarray:
    """Return the radiance (M, L + 1, count) float32 of `rows` for coefficients of 1: DIFFUSE, SPECULAR, GRAZING, and 0 beyond them.

    The response under the dome, which is last, is a first estimate.
    """
    normals = surface.normals_facing(view, rows)
    responses = np.zeros((len(rows), len(suns.directions) + 1, count), np.float32)
    responses[:, :-1, DIFFUSE] = suns.diffuse_response(normals)
    responses[:, :-1, SPECULAR] = suns.specular_response(normals, view, np.maximum(surface.roughness[rows], MIN_ROUGHNESS))
    responses[:, -1, [DIFFUSE, SPECULAR]] = 1.0
    cosines = normals @ view
    responses[..., GRAZING] = responses[..., SPECULAR] * SCHLICK(cosines)[:, None]
    if suns.visibility is not None:
        responses[:, :-1, :LOBE_COUNT] *= suns.visibility[rows, :, None]
    if suns.sky_visibility is not None:
        responses[:, -1, :LOBE_COUNT] *= suns.sky_visibility[rows, None]
    return responses
