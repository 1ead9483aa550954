"""Nested boxes about a viewer: their voxels, and what stands about any corner of theirs, also where two levels meet."""

from dataclasses import dataclass

import numpy as np

from ..progress import Progress, Steps, scaled
from . import surface
from .layout import Cuboid, Layout, layout_about, same_layout
from .patterns import DIRECTIONS, OCTANTS
from .settings import ClipboxSettings
from .terrains import Sampler
from .volumes import Volume

ABOUT = np.array([OCTANTS[OCTANTS[:, axis] == high] for axis in range(3) for high in (0, 1)])  # (6, 4, 3) octants about each half edge


@dataclass(frozen=True)
class About:
    """What stands about corners: values (8, K) densities of the octants, centres (8, 3, K) float32 where these belong, from the corner,
    in voxels of the corner's level."""

    values: np.ndarray
    centres: np.ndarray


class NestedBoxes:
    """The voxels of all levels. Finer levels than `finest` have none: they are made by subdividing.

    Its methods that read may only be called between two moves.
    """

    def __init__(self, terrain: Sampler, settings: ClipboxSettings, closed: bool = False) -> None:
        """closed: whether there is nothing beyond the outermost box, so that walls close the ground there; else it goes on as it ends."""
        self.settings = settings
        self.closed = closed
        self.finest = settings.subdivided
        self.layout: Layout | None = None
        fill = terrain.densities if settings.surface == "smooth" else lambda grid: terrain.bits(grid, settings.smoothing > 0)
        self.volumes = [Volume(settings.resolution, settings.voxel * 2**level, fill) for level in range(self.finest, settings.boxes)]

    @property
    def coarsest(self) -> int:
        """The outermost level."""
        return self.settings.boxes - 1

    def volume(self, level: int) -> Volume:
        """The voxels of a level."""
        return self.volumes[level - self.finest]

    def move(self, viewer: np.ndarray) -> Steps[None]:
        """Let the boxes lie about a viewer at (3,) scene units. When it is stopped or fails, it can be called again."""
        layout = self._layout_about(viewer)
        self.layout = None
        for number, volume in enumerate(self.volumes):
            steps = volume.move(layout.origins[self.finest + number])
            yield from scaled(steps, number / len(self.volumes), (number + 1) / len(self.volumes))
        self.layout = layout
        yield Progress(1.0, "Working out voxels")

    def lie_about(self, viewer: np.ndarray) -> bool:
        """Whether the boxes lie about a viewer at (3,) already."""
        return self.layout is not None and same_layout(self.layout, self._layout_about(viewer))

    def _layout_about(self, viewer: np.ndarray) -> Layout:
        return layout_about(viewer, self.settings)

    def hole(self, level: int) -> Cuboid | None:
        """The voxels of `level` that finer voxels stand for."""
        return self.layout.hole(level) if level > self.finest else None

    def window(self, level: int, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """The voxels `low` to `high` of a level; next to what it shows, those of the next coarser one, and farther out
        what counts nowhere; where there is none, the outermost again."""
        shown = self.layout.shown[level]
        first, last = np.maximum(low, shown.low), np.minimum(high, shown.high)
        window = self.volume(level).window(first, last)
        if window.shape == tuple((high - low).tolist()):
            return window
        if level < self.coarsest:
            near_low, near_high = np.maximum(low, shown.low - 2), np.minimum(high, shown.high + 2)
            beyond = self.volume(level + 1).window(near_low // 2, -(-near_high // 2))
            found = np.full(tuple((high - low).tolist()), window.flat[0])  # which is what there is, or counts nowhere
            if _alike(window, beyond):
                return found
            for axis in range(3):
                beyond = beyond.repeat(2, axis)
            beyond = beyond[slices_of(near_low - near_low // 2 * 2, near_high - near_low // 2 * 2)]
            beyond[slices_of(first - near_low, last - near_low)] = window
            found[slices_of(near_low - low, near_high - low)] = beyond
            return found
        padded = np.pad(window, np.stack([first - low, high - last], axis=1), mode="edge")
        if self.closed and level == self.coarsest:
            outside = np.ones(padded.shape, bool)
            outside[slices_of(first - low, last - low)] = False
            padded[outside] = -np.abs(padded[outside])
        return padded

    def about(self, level: int, corners: np.ndarray) -> About:
        """What stands about the corners (K, 3) of a level's lattice that lie in what it shows or on the border of that."""
        voxels = corners[:, None] + OCTANTS - 1
        shown, hole = self.layout.shown[level], self.hole(level)
        values = self.volume(level).at(np.clip(voxels, shown.low, shown.high - 1))
        if self.closed and level == self.coarsest:
            values = np.where(shown.contains(voxels), values, -np.abs(values))
        centres = np.broadcast_to((OCTANTS - 0.5).astype(np.float32), voxels.shape).copy()
        if hole is not None and (finer := hole.contains(voxels)).any():
            within = (2 * corners[:, None] + OCTANTS - 1)[finer]
            values[finer] = self.volume(level - 1).at(within)
            centres[finer] *= np.float32(0.5)
        if level < self.coarsest and (coarser := ~shown.contains(voxels)).any():
            values[coarser] = self.volume(level + 1).at(voxels[coarser] // 2)
            centres[coarser] = (voxels // 2 * 2 + 1 - corners[:, None])[coarser]
        return About(values.T, np.moveaxis(centres, 0, 2))

    def patterns_beyond(self, level: int, corners: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """The patterns (K,) of the corners at the other ends of the edges that leave `corners` (K, 3) of a level in `directions` (K,)."""
        voxels, steps = corners[:, None] + ABOUT[directions] - 1, DIRECTIONS[directions]
        hole, shown = self.hole(level), self.layout.shown[level]
        finer = np.zeros(len(corners), bool) if hole is None else hole.contains(voxels).any(axis=1)
        coarser = np.zeros(len(corners), bool) if level == self.coarsest else ~finer & ~shown.contains(voxels).any(axis=1)
        found = np.empty(len(corners), np.int64)
        for those, of_level, ends in (
            (finer, level - 1, 2 * corners + steps),
            (coarser, level + 1, corners // 2 + steps),
            (~(finer | coarser), level, corners + steps),
        ):
            if those.any():
                found[those] = surface.patterns_of(surface.bits_of(self.about(of_level, ends[those]).values))
        return found


def slices_of(low: np.ndarray, high: np.ndarray) -> tuple[slice, ...]:
    """The part `low` to `high` (3,) of an array."""
    return tuple(slice(*span) for span in zip(low.tolist(), high.tolist(), strict=True))


def _alike(*parts: np.ndarray) -> bool:
    """Whether all voxels of all `parts` are set, or none is."""
    bits = [surface.bits_of(part) for part in parts]
    return all(part.all() for part in bits) or not any(part.any() for part in bits)
