"""Suns as broad as a cell of a grid: what lobes make of them, by tables."""

from functools import cached_property

import numpy as np

ROUGHNESSES = np.geomspace(0.04, 1.0, 24)  # rows of the table of mirrored suns
ANGLES = 257  # from 0 to pi: columns of both tables
RINGS = 4000
SPIRAL = 256  # places on a disc


class BroadSuns:
    """L suns from unit `directions` (L, 3), each a disc of `solid_angle` with unit irradiance across its beam."""

    def __init__(self, directions: np.ndarray, solid_angle: float) -> None:
        self.directions = directions
        self._solid_angle = solid_angle
        self.radius = float(np.arccos(1.0 - solid_angle / (2.0 * np.pi)))

    def cosine(self, normals: np.ndarray) -> np.ndarray:
        """What white Lambert surfaces with `normals` (N, 3) show of each, (N, L): the mean of the cosine above 0 over its disc, over pi."""
        return np.interp(np.arccos(np.clip(normals @ self.directions.T, -1.0, 1.0)), self._angles, self._cosines)

    def mirrored(self, normals: np.ndarray, view: np.ndarray, roughness: np.ndarray) -> np.ndarray:
        """What a glossy surface that loses nothing shows of each from `view` (3,), (N, L); normals (N, 3) on that side, roughness (N,).

        The lobe is taken for round about the mirrored view and the share of the disc above the surface for even: within a tenth of the
        integral for roughnesses up to 0.4, away from grazing angles.
        """
        mirrored = 2.0 * (normals @ view)[:, None] * normals - view
        angles = np.arccos(np.clip(mirrored @ self.directions.T, -1.0, 1.0)) * ((ANGLES - 1) / np.pi)
        column = np.minimum(angles.astype(np.int64), ANGLES - 2)
        place = np.interp(np.log(roughness), np.log(ROUGHNESSES), np.arange(len(ROUGHNESSES)))
        row = np.minimum(place.astype(np.int64), len(ROUGHNESSES) - 2)[:, None]
        right, down = angles - column, place[:, None] - row
        table = self._mirror
        upper = table[row, column] * (1.0 - right) + table[row, column + 1] * right
        lower = table[row + 1, column] * (1.0 - right) + table[row + 1, column + 1] * right
        heights = np.arcsin(np.clip(normals @ self.directions.T, -1.0, 1.0))
        return (upper * (1.0 - down) + lower * down) * np.clip(0.5 + 0.5 * heights / self.radius, 0.0, 1.0)

    @cached_property
    def _angles(self) -> np.ndarray:
        return np.linspace(0.0, np.pi, ANGLES)

    @cached_property
    def _cosines(self) -> np.ndarray:
        """By the angle between normal and the middle of the disc."""
        z = 1.0 - (np.arange(SPIRAL) + 0.5) / SPIRAL * (1.0 - np.cos(self.radius))
        turn = np.arange(SPIRAL) * np.pi * (3.0 - np.sqrt(5.0))
        across = np.sqrt(1.0 - z**2) * np.cos(turn)
        return np.maximum(np.outer(np.sin(self._angles), across) + np.outer(np.cos(self._angles), z), 0.0).mean(axis=1) / np.pi

    @cached_property
    def _mirror(self) -> np.ndarray:
        """By roughness and by the angle between the mirrored view and the middle of the disc: the lobe's share within it, over its size."""
        edges = np.linspace(0.0, np.pi, RINGS + 1)
        ring = 0.5 * (edges[1:] + edges[:-1])
        apart = self._angles[:, None]
        # A ring around the mirrored view lies in the disc where its cosine to the middle is that of the radius or more.
        turned = (np.cos(self.radius) - np.cos(apart) * np.cos(ring)) / np.maximum(np.sin(apart) * np.sin(ring), 1e-9)
        inside = np.arccos(np.clip(turned, -1.0, 1.0)) / np.pi
        alpha = ROUGHNESSES[:, None] ** 4
        lobes = alpha / (np.cos(0.5 * ring) ** 2 * (alpha - 1.0) + 1.0) ** 2 * np.sin(ring)
        return (lobes / lobes.sum(axis=1, keepdims=True)) @ inside.T / self._solid_angle
