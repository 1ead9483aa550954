"""The terrain generators, and sampling of the density functions that they build.

A density function returns the densities of a voxel grid: positive where solid, NaN counts as air. It is built once from the settings and
then called from any thread, in any order. The density of a voxel must not depend on the grid that it is part of. Densities should be about
the signed distance to the surface in scene units.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...errors import FileError, GeometryError
from ..files.readers import READERS, Readers
from ..meshing.surface_nets import REPAIR_MARGIN, is_solid, repair_voxels
from ..settings import ClipboxSettings
from .caverns import CARVINGS
from .edits import NO_EDITS, Edits
from .forest import build_forest
from .formulas import Formula
from .grids import DensityFunction, Grid, smooth_minimum
from .heights import build_heights
from .landscapes import LANDSCAPES, build_landscape
from .noise import fbm
from .spheres import SphereField, csg_density, find_touching_spheres
from .volume_terrain import build_volume

MAX_DENSITY = 6.0e4  # close to the maximum of half precision
MIN_POSITIVE_DENSITY = 6.0e-8  # the smallest positive number of half precision
FUNCTION_ERRORS = (ArithmeticError, AttributeError, LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError)

Builder = Callable[[ClipboxSettings, Readers], DensityFunction]


@dataclass(frozen=True)
class Sampler:
    """A density function with checked results, and what the user has added and subtracted."""

    name: str
    function: DensityFunction
    edits: Edits = NO_EDITS

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences for the user about the file that the function has read."""
        return getattr(self.function, "warnings", ())

    def signs(self, grid: Grid, repair: bool) -> np.ndarray:
        """Return 1 for solid voxels and -1 for air, (X, Y, Z) int8. `repair` prepares the voxels for smoothing.

        Raises:
            GeometryError: as `densities`.
        """
        if not repair:
            solid = is_solid(self.densities(grid))
        else:
            origin = tuple(index - REPAIR_MARGIN for index in grid.origin)
            shape = tuple(count + 2 * REPAIR_MARGIN for count in grid.shape)
            solid = repair_voxels(is_solid(self.densities(Grid(origin, shape, grid.voxel_size))))
        return np.where(solid, np.int8(1), np.int8(-1))

    def densities(self, grid: Grid) -> np.ndarray:
        """Return the densities (X, Y, Z) float16 of a grid. NaN becomes air.

        Raises:
            GeometryError: the function fails or returns another shape.
        """
        try:
            values = np.asarray(self.function(grid))
            values = self.edits.apply(grid, np.broadcast_to(values, grid.shape))
            clipped = np.clip(values, -MAX_DENSITY, MAX_DENSITY)
            clipped[np.isnan(clipped)] = -1.0
        except FUNCTION_ERRORS as error:
            position = ", ".join(f"{index * grid.voxel_size:g}" for index in grid.origin)
            raise GeometryError(f'The terrain "{self.name}" failed at {position}: {error}.') from error
        half = clipped.astype(np.float16)
        half[(clipped > 0.0) & (clipped < MIN_POSITIVE_DENSITY)] = MIN_POSITIVE_DENSITY
        return half


def build_sampler(source: ClipboxSettings, readers: Readers = READERS, edits: Edits = NO_EDITS) -> Sampler:
    """Build the density function of a terrain. Source files are read with the given readers.

    Raises:
        SettingsError, FileError: its formula or its source file cannot be read.
    """
    try:
        return Sampler(source.terrain, BUILDERS[source.terrain](source, readers), edits)
    except MemoryError:
        raise FileError(f'"{source.source}" needs more memory than is available; reduce its size.') from None


def build_cascades(source: ClipboxSettings, _readers: Readers) -> DensityFunction:
    """Build mountains of ridged noise with overhangs, arches and winding caves."""
    seed, scale = 16 * source.seed, source.scale

    def densities(grid: Grid) -> np.ndarray:
        _, _, z = grid.coordinates()
        ridges = fbm(grid, 420.0 * scale, 6, seed, gain=0.48, ridged=True, squash=0.6)
        ground = ridges
        ground *= np.float32(110.0 * scale)
        ground += fbm(grid, 90.0 * scale, 5, seed + 1, gain=0.5) * np.float32(26.0 * scale)
        ground -= (z + 165.0 * scale).astype(np.float32)
        if grid.voxel_size > 5.0 * scale:  # half the width of the tunnels: they cannot be resolved
            return ground
        tunnels = fbm(grid, 130.0 * scale, 2, seed + 2) ** 2
        tunnels += fbm(grid, 110.0 * scale, 2, seed + 3, squash=1.5) ** 2
        np.sqrt(tunnels, out=tunnels)
        tunnels -= np.float32(0.12)
        tunnels *= np.float32(60.0 * scale)
        return smooth_minimum(ground, tunnels, np.float32(max(8.0 * scale, 3.0 * grid.voxel_size)))

    return densities


def build_islands(source: ClipboxSettings, _readers: Readers) -> DensityFunction:
    """Build layers of floating rocks, rough below and flatter above."""
    seed, scale = 16 * source.seed + 5, source.scale

    def densities(grid: Grid) -> np.ndarray:
        _, _, z = grid.coordinates()
        rocks = fbm(grid, 150.0 * scale, 5, seed, gain=0.45) * np.float32(70.0 * scale)
        height_in_layer = (z / (130.0 * scale) + 0.5) % 1.0 - 0.5  # -0.5 to 0.5 in every layer
        falloff = np.where(height_in_layer > 0.0, 260.0, 70.0) * scale * np.abs(height_in_layer)
        rocks -= (falloff + 14.0 * scale).astype(np.float32)
        return rocks

    return densities


def build_spheres(source: ClipboxSettings, _readers: Readers) -> DensityFunction:
    """Build terrain from spheres of several size classes that are added and subtracted."""
    scale = source.scale
    field = SphereField(
        max_radius=source.sphere_radius * scale,
        class_count=source.sphere_classes,
        spheres_per_cell=source.sphere_count,
        subtracted_fraction=source.sphere_subtracted,
        max_height=source.sphere_height * scale,
        seed=source.seed,
    )
    return lambda grid: csg_density(grid, find_touching_spheres(field, grid))


def build_formula(source: ClipboxSettings, _readers: Readers) -> DensityFunction:
    """Build the formula typed by the user."""
    return _evaluate_scaled(source.formula, source.scale)


def _evaluate_scaled(formula: str, scale: float) -> DensityFunction:
    function = Formula(formula)
    return lambda grid: function(*(coordinates / scale for coordinates in grid.coordinates()))


def _preset(formula: str) -> Builder:
    return lambda source, _readers: _evaluate_scaled(formula, source.scale)


BUILDERS: dict[str, Builder] = {
    **dict.fromkeys(LANDSCAPES, lambda source, _readers: build_landscape(source, CARVINGS.get(source.terrain))),
    "cascades": build_cascades,
    "islands": build_islands,
    "spheres": build_spheres,
    "formula": build_formula,
    "xor": _preset("2*mod(xor(x/4, y/4), 32) - 40 - z"),
    "sawtooth": _preset("mod(x, 48) + mod(y, 64)/2 + 12*mod(z/24, 1) - 70 - z"),
    "sine": _preset("26*sin(x/40)*sin(y/34) + 14*sin(z/9)*sin((x + y)/30) - z"),
    "volume": build_volume,
    "forest": build_forest,
    "heights": build_heights,
}
