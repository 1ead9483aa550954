"""The voxels of nested boxes around a viewer, and the octants of any of their corners, also where two levels meet."""

from dataclasses import dataclass

import numpy as np

from ..jobs.progress import Progress, Steps, subprogress
from .layout import BoxLayout, IntBox, box_slices, is_same_layout, layout_around, transition_range
from .meshing import surface_nets
from .meshing.case_table import DIRECTIONS, OCTANTS
from .settings import ClipboxSettings
from .terrains.generators import Sampler
from .toroidal_grid import ToroidalGrid
from .transitions import MAX_WIDTH, RESOLUTION_PER_WIDTH, BorderTransition, Transition, ViewerTransition

# (6, 4, 3) octants around the lattice edge that leaves a corner in each direction
EDGE_OCTANTS = np.array([OCTANTS[OCTANTS[:, axis] == high] for axis in range(3) for high in (0, 1)])
MAX_KNOWN_SIGNS = 1 << 14  # Windows of voxels that are remembered. A terrain has a few thousand blocks at most.


@dataclass(frozen=True)
class CornerNeighborhood:
    """The octants of corners.

    values (8, K): densities. centers (8, 3, K) float32: center of each octant relative to the corner, in voxels of the corner's level.
    """

    values: np.ndarray
    centers: np.ndarray


class NestedBoxes:
    """The voxels of all levels. Levels finer than `finest_level` have none: they are subdivided.

    Methods that read voxels must not be called during a move.
    """

    def __init__(self, terrain: Sampler, settings: ClipboxSettings, closed: bool = False) -> None:
        """Prepare boxes without voxels.

        closed: whether it is empty outside the outermost box, so that walls close the ground there. Otherwise the outermost voxels repeat.
        """
        self.settings = settings
        self.closed = closed
        self.finest_level = settings.subdivided_boxes
        self.layout: BoxLayout | None = None
        self._transitions: dict[int, Transition] = {}
        self._has_one_sign: dict[tuple[int, ...], bool] = {}
        sample = terrain.densities if settings.surface == "smooth" else lambda grid: terrain.signs(grid, settings.smoothing > 0)
        self.grids = [
            ToroidalGrid(settings.resolution, settings.voxel_size * 2**level, sample) for level in range(self.finest_level, settings.boxes)
        ]

    @property
    def coarsest_level(self) -> int:
        """Level of the outermost box."""
        return self.settings.boxes - 1

    def grid(self, level: int) -> ToroidalGrid:
        """Return the voxels of a level."""
        return self.grids[level - self.finest_level]

    def move(self, viewer: np.ndarray, travel: float = 0.0) -> Steps[None]:
        """Center the boxes on a viewer at (3,) scene units. If it is cancelled or fails, it can be called again.

        travel: see `layout_around`. Boxes that are not shown stay where they are.
        """
        layout = layout_around(viewer, self.settings, travel)
        self.layout = None
        levels = range(layout.first_level, self.settings.boxes)
        for index, level in enumerate(levels):
            steps = self.grid(level).move(layout.origins[level])
            yield from subprogress(steps, index / len(levels), (index + 1) / len(levels))
        self.layout, self._transitions = layout, {}
        yield Progress(1.0, "Computing voxels")

    def is_centered_on(self, viewer: np.ndarray) -> bool:
        """Return whether a move to a viewer at (3,) would change nothing."""
        return self.layout is not None and is_same_layout(self.layout, layout_around(viewer, self.settings))

    def hole(self, level: int) -> IntBox | None:
        """Return the voxels of `level` that finer voxels replace."""
        return self.layout.hole(level)

    def transition(self, level: int) -> Transition | None:
        """Return the transition from a level to the next coarser one; None for the outermost box, and for blocks, whose shape is exact."""
        if level == self.coarsest_level or self.settings.surface == "blocky":
            return None
        if level not in self._transitions:
            self._transitions[level] = self._create_transition(level)
        return self._transitions[level]

    def _create_transition(self, level: int) -> Transition:
        visible, coarser = self.layout.visible[level], self.grid(level + 1)
        if self.layout.centers:
            return ViewerTransition.around(self.layout.centers[level], *transition_range(self.settings), visible, coarser)
        return BorderTransition(visible, min(self.settings.resolution // RESOLUTION_PER_WIDTH, MAX_WIDTH), coarser)

    def has_one_sign(self, level: int, low: np.ndarray, high: np.ndarray) -> bool:
        """Return whether the window `low` to `high` of a level is all solid or all empty, wherever transitions are.

        Asked for again and again while transitions move. It is therefore remembered: voxels stay as they are.
        """
        if self.transition(level) is None:
            return False
        visible = self.layout.visible[level]
        low, high = np.maximum(low, visible.low), np.minimum(high, visible.high)
        key = (level, *low.tolist(), *high.tolist())
        if key not in self._has_one_sign:
            if len(self._has_one_sign) >= MAX_KNOWN_SIGNS:
                self._has_one_sign.clear()
            coarser = self.grid(level + 1).window((low - 1) // 2, high // 2 + 1)  # Also those next to the border.
            self._has_one_sign[key] = surface_nets.have_one_sign(self.grid(level).window(low, high), coarser)
        return self._has_one_sign[key]

    def window(self, level: int, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return the voxels `low` to `high` of a level.

        Two voxels around its visible part are those of the next coarser level. Voxels beyond these are not used anywhere, and have any
        value. Around the outermost box its voxels repeat.
        """
        visible = self.layout.visible[level]
        first, last = np.maximum(low, visible.low), np.minimum(high, visible.high)
        window = self._visible_window(level, first, last)
        if window.shape == tuple((high - low).tolist()):
            return window
        if level < self.coarsest_level:
            near_low, near_high = np.maximum(low, visible.low - 2), np.minimum(high, visible.high + 2)
            coarser = self._visible_window(level + 1, near_low // 2, -(-near_high // 2))
            result = np.full(tuple((high - low).tolist()), window.flat[0])  # the right value if all are alike, otherwise unused
            if surface_nets.have_one_sign(window, coarser):
                return result
            for axis in range(3):
                coarser = coarser.repeat(2, axis)
            coarser = coarser[box_slices(near_low - near_low // 2 * 2, near_high - near_low // 2 * 2)]
            coarser[box_slices(first - near_low, last - near_low)] = window
            result[box_slices(near_low - low, near_high - low)] = coarser
            return result
        padded = np.pad(window, np.stack([first - low, high - last], axis=1), mode="edge")
        if self.closed and level == self.coarsest_level:
            is_outside = np.ones(padded.shape, bool)
            is_outside[box_slices(first - low, last - low)] = False
            padded[is_outside] = -np.abs(padded[is_outside])
        return padded

    def _visible_window(self, level: int, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return the voxels `low` to `high` of the visible part of a level."""
        window, transition = self.grid(level).window(low, high), self.transition(level)
        if transition is None or ((low >= transition.unblended.low) & (high <= transition.unblended.high)).all():
            return window
        return transition.blend_window(low, window)

    def _visible_values(self, level: int, voxels: np.ndarray) -> np.ndarray:
        """Return the values (...) of `voxels` (..., 3) in the visible part of a level; of others, those of the nearest ones."""
        visible, transition = self.layout.visible[level], self.transition(level)
        values = self.grid(level).values_at(np.clip(voxels, visible.low, visible.high - 1))
        return values if transition is None else transition.blend_voxels(voxels, values)

    def gather_octants(self, level: int, corners: np.ndarray) -> CornerNeighborhood:
        """Return the octants of corners (K, 3) of a level's lattice, which lie in its visible part or on the boundary of that."""
        voxels = corners[:, None] + OCTANTS - 1
        visible, hole = self.layout.visible[level], self.hole(level)
        values = self._visible_values(level, voxels)
        if self.closed and level == self.coarsest_level:
            values = np.where(visible.contains(voxels), values, -np.abs(values))
        centers = np.broadcast_to((OCTANTS - 0.5).astype(np.float32), voxels.shape).copy()
        if hole is not None and (is_finer := hole.contains(voxels)).any():
            finer_voxels = (2 * corners[:, None] + OCTANTS - 1)[is_finer]
            values[is_finer] = self._visible_values(level - 1, finer_voxels)
            centers[is_finer] *= np.float32(0.5)
        if level < self.coarsest_level and (is_coarser := ~visible.contains(voxels)).any():
            values[is_coarser] = self._visible_values(level + 1, voxels[is_coarser] // 2)
            centers[is_coarser] = (voxels // 2 * 2 + 1 - corners[:, None])[is_coarser]
        return CornerNeighborhood(values.T, np.moveaxis(centers, 0, 2))

    def cases_at_edge_ends(self, level: int, corners: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return the cases (K,) of the other ends of the lattice edges that leave `corners` (K, 3) of a level in `directions` (K,)."""
        voxels, steps = corners[:, None] + EDGE_OCTANTS[directions] - 1, DIRECTIONS[directions]
        hole, visible = self.hole(level), self.layout.visible[level]
        is_finer = np.zeros(len(corners), bool) if hole is None else hole.contains(voxels).any(axis=1)
        has_coarser = level < self.coarsest_level
        is_coarser = ~is_finer & ~visible.contains(voxels).any(axis=1) if has_coarser else np.zeros(len(corners), bool)
        cases = np.empty(len(corners), np.int64)
        for rows, end_level, ends in (
            (is_finer, level - 1, 2 * corners + steps),
            (is_coarser, level + 1, corners // 2 + steps),
            (~(is_finer | is_coarser), level, corners + steps),
        ):
            if rows.any():
                octants = self.gather_octants(end_level, ends[rows])
                cases[rows] = surface_nets.case_indices(surface_nets.is_solid(octants.values))
        return cases
