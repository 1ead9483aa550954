"""Suns as broad as a cell of a grid: what lobes make of them, by tables."""

from copy import copy
from functools import cached_property

import numpy as np

ROUGHNESSES = np.geomspace(0.04, 1.0, 65)  # rows of the table of mirrored suns
COSINES = 4097  # from -1 to 1: columns of both tables
RINGS = 1000
SPIRAL = 256  # places on a disc


def disc_radius(solid_angle: float) -> float:
    """The angle in radians between the middle and the rim of a disc of so many steradians."""
    return float(np.arccos(1.0 - solid_angle / (2.0 * np.pi)))


class BroadSuns:
    """L suns from unit `directions` (L, 3), each a disc of `solid_angle` with unit irradiance across its beam.

    reached: how much (N, L) of each reaches N texels, and openness: how much (N,) of a dome does; None where nothing keeps it from them.
    """

    def __init__(self, directions: np.ndarray, solid_angle: float) -> None:
        self.directions = directions
        self.reached: np.ndarray | None = None
        self.openness: np.ndarray | None = None
        self._solid_angle = solid_angle
        self.radius = disc_radius(solid_angle)

    def behind(self, reached: np.ndarray, openness: np.ndarray) -> "BroadSuns":
        """These suns, but only so much of each, and of a dome, reaches the texels."""
        made = copy(self)
        made.reached, made.openness = reached, openness
        return made

    def prepare(self) -> None:
        """Make the tables, which threads that need them at the same time would each make."""
        _ = self._matt, self._glossy

    def cosine(self, normals: np.ndarray) -> np.ndarray:
        """What white Lambert surfaces with `normals` (N, 3) show of each, (N, L): the mean of the cosine above 0 over its disc, over pi."""
        return self._matt[self._columns(normals)]

    def mirrored(self, normals: np.ndarray, view: np.ndarray, roughness: np.ndarray) -> np.ndarray:
        """What a glossy surface that loses nothing shows of each from `view` (3,), (N, L); normals (N, 3) on that side, roughness (N,).

        The lobe is taken for round about the mirrored view and the share of the disc above the surface for even: within a tenth of the
        integral for roughnesses up to 0.4, away from grazing angles.
        """
        mirrored = 2.0 * (normals @ view)[:, None] * normals - view
        rows = np.rint(np.interp(np.log(roughness), np.log(ROUGHNESSES), np.arange(len(ROUGHNESSES)))).astype(np.int32)
        shown = self._glossy.ravel()[self._columns(mirrored) + COSINES * rows[:, None]]
        heights = normals.astype(np.float32) @ self.directions.T.astype(np.float32)
        return shown * np.clip(0.5 + 0.5 / np.sin(self.radius) * heights, 0.0, 1.0)

    def _columns(self, directions: np.ndarray) -> np.ndarray:
        """The columns (N, L) int32 for the cosines between unit `directions` (N, 3) and the suns."""
        half = 0.5 * (COSINES - 1)
        cosines = directions.astype(np.float32) @ (half * self.directions.T).astype(np.float32)
        return np.clip(np.rint(cosines + half), 0, COSINES - 1).astype(np.int32)

    @cached_property
    def _angles(self) -> np.ndarray:
        return np.arccos(np.linspace(-1.0, 1.0, COSINES))

    @cached_property
    def _matt(self) -> np.ndarray:
        """By the angle between normal and the middle of the disc."""
        z = 1.0 - (np.arange(SPIRAL) + 0.5) / SPIRAL * (1.0 - np.cos(self.radius))
        turn = np.arange(SPIRAL) * np.pi * (3.0 - np.sqrt(5.0))
        across = np.sqrt(1.0 - z**2) * np.cos(turn)
        seen = np.maximum(np.outer(np.sin(self._angles), across) + np.outer(np.cos(self._angles), z), 0.0)
        return (seen.mean(axis=1) / np.pi).astype(np.float32)

    @cached_property
    def _glossy(self) -> np.ndarray:
        """By roughness and by the angle between the mirrored view and the middle of the disc: the lobe's share within it, over its size."""
        ring = np.pi * ((np.arange(RINGS) + 0.5) / RINGS) ** 2  # narrow ones in the middle, where smooth lobes are
        widths = np.pi * np.diff((np.arange(RINGS + 1) / RINGS) ** 2)
        apart = self._angles[:, None]
        # A ring around the mirrored view lies in the disc where its cosine to the middle is that of the radius or more.
        turned = (np.cos(self.radius) - np.cos(apart) * np.cos(ring)) / np.maximum(np.sin(apart) * np.sin(ring), 1e-9)
        inside = np.arccos(np.clip(turned, -1.0, 1.0)) / np.pi
        alpha = ROUGHNESSES[:, None] ** 4
        lobes = alpha / (np.cos(0.5 * ring) ** 2 * (alpha - 1.0) + 1.0) ** 2 * np.sin(ring) * widths
        return (lobes / lobes.sum(axis=1, keepdims=True) @ inside.T / self._solid_angle).astype(np.float32)
