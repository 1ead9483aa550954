"""Disc-shaped distant lights: response of the lobes to them, from lookup tables."""

from copy import copy
from functools import cached_property, lru_cache

import numpy as np

TABLE_ROUGHNESSES = np.geomspace(0.04, 1.0, 65)  # Rows of the specular table.
TABLE_COSINES = 4097  # Columns of both tables, from -1 to 1.
RING_COUNT = 1000  # Rings around the mirror direction that the specular lobe is integrated over.
DISC_SAMPLES = 256  # On a spiral, for the diffuse table.


def disc_radius(solid_angle: float) -> float:
    """Return the angular radius in radians of a disc of `solid_angle` steradians."""
    return float(np.arccos(1.0 - solid_angle / (2.0 * np.pi)))


class DiscLights:
    """L suns in the unit `directions` (L, 3). Each is a disc of `solid_angle` steradians with unit irradiance perpendicular to it.

    visibility: visible fraction (N, L) of each sun from N texels, sky_visibility: of a dome (N,); both None for 1.
    """

    def __init__(self, directions: np.ndarray, solid_angle: float) -> None:
        self.directions = directions
        self.visibility: np.ndarray | None = None
        self.sky_visibility: np.ndarray | None = None
        self._solid_angle = solid_angle
        self.radius = disc_radius(solid_angle)

    def with_visibility(self, visibility: np.ndarray, sky_visibility: np.ndarray) -> "DiscLights":
        """Return the same suns with this visibility."""
        lights = copy(self)
        lights.visibility, lights.sky_visibility = visibility, sky_visibility
        return lights

    def build_tables(self) -> None:
        """Build the tables before several threads use them; otherwise each thread would build them."""
        _ = self._diffuse_table, self._specular_table

    def diffuse_response(self, normals: np.ndarray) -> np.ndarray:
        """Return the radiance (N, L) of white Lambertian surfaces with `normals` (N, 3): mean clamped cosine over each disc, over pi."""
        return self._diffuse_table[self._columns(normals)]

    def specular_response(self, normals: np.ndarray, view: np.ndarray, roughness: np.ndarray) -> np.ndarray:
        """Return the radiance (N, L) of lossless specular surfaces seen from `view` (3,); normals (N, 3) facing it, roughness (N,).

        Approximations: the lobe is symmetric around the mirror direction, and the part of a disc above the surface is uniform. The error is
        below a tenth of the integral for roughnesses up to 0.4, except at grazing angles.
        """
        mirror_directions = 2.0 * (normals @ view)[:, None] * normals - view
        table_rows = np.interp(np.log(roughness), np.log(TABLE_ROUGHNESSES), np.arange(len(TABLE_ROUGHNESSES)))
        rows = np.rint(table_rows).astype(np.int32)
        radiance = self._specular_table.ravel()[self._columns(mirror_directions) + TABLE_COSINES * rows[:, None]]
        heights = normals.astype(np.float32) @ self.directions.T.astype(np.float32)
        return radiance * np.clip(0.5 + 0.5 / np.sin(self.radius) * heights, 0.0, 1.0)

    def _columns(self, directions: np.ndarray) -> np.ndarray:
        """Return the table columns (N, L) int32 of the cosines between unit `directions` (N, 3) and the suns."""
        half = 0.5 * (TABLE_COSINES - 1)
        cosines = directions.astype(np.float32) @ (half * self.directions.T).astype(np.float32)
        return np.clip(np.rint(cosines + half), 0, TABLE_COSINES - 1).astype(np.int32)

    @cached_property
    def _diffuse_table(self) -> np.ndarray:
        """Diffuse response by the angle between normal and disc center."""
        z = 1.0 - (np.arange(DISC_SAMPLES) + 0.5) / DISC_SAMPLES * (1.0 - np.cos(self.radius))
        azimuths = np.arange(DISC_SAMPLES) * np.pi * (3.0 - np.sqrt(5.0))
        x = np.sqrt(1.0 - z**2) * np.cos(azimuths)
        angles = _table_angles()
        cosines = np.maximum(np.outer(np.sin(angles), x) + np.outer(np.cos(angles), z), 0.0)
        return (cosines.mean(axis=1) / np.pi).astype(np.float32)

    @cached_property
    def _specular_table(self) -> np.ndarray:
        """Fraction of the lobe inside the disc, over the disc's solid angle, by roughness and by the angle between the mirror direction and
        the disc center."""
        return _build_specular_table(self._solid_angle)


@lru_cache(maxsize=2)  # A bake uses one, for all levels of a cloud.
def _build_specular_table(solid_angle: float) -> np.ndarray:
    ring_angles = np.pi * ((np.arange(RING_COUNT) + 0.5) / RING_COUNT) ** 2  # Dense near the mirror direction, for smooth lobes.
    ring_widths = np.pi * np.diff((np.arange(RING_COUNT + 1) / RING_COUNT) ** 2)
    angles = _table_angles()[:, None]
    # A point of a ring around the mirror direction is inside the disc where its angle to the disc's center is at most the radius.
    cosines = np.cos(disc_radius(solid_angle)) - np.cos(angles) * np.cos(ring_angles)
    cosines /= np.maximum(np.sin(angles) * np.sin(ring_angles), 1e-9)
    inside_fractions = np.arccos(np.clip(cosines, -1.0, 1.0)) / np.pi
    alpha = TABLE_ROUGHNESSES[:, None] ** 4
    lobes = alpha / (np.cos(0.5 * ring_angles) ** 2 * (alpha - 1.0) + 1.0) ** 2 * np.sin(ring_angles) * ring_widths
    table = (lobes / lobes.sum(axis=1, keepdims=True) @ inside_fractions.T / solid_angle).astype(np.float32)
    table.flags.writeable = False
    return table


def _table_angles() -> np.ndarray:
    return np.arccos(np.linspace(-1.0, 1.0, TABLE_COSINES))
