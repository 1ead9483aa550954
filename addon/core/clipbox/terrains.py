"""The terrains: functions that give a grid of voxels its densities, above 0 where there is solid ground.

`register` adds further ones. A terrain is made once from the settings and then asked for grids, from any thread, in any order; its answer
for a voxel must not depend on the grid that it is part of. Densities should be about the distance to the surface in scene units.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import GeometryError
from .formulas import Formula
from .grids import Grid
from .noise import fractal
from .repair import MARGIN, repaired
from .spheres import SphereField, carved, spheres_touching
from .surface import bits_of

if TYPE_CHECKING:
    from .settings import ClipboxSettings

Densities = Callable[[Grid], np.ndarray]
Maker = Callable[["ClipboxSettings"], Densities]

NAMES: dict[str, str] = {}
_MAKERS: dict[str, Maker] = {}

PRESETS = {
    "xor": ("Steps as high as the exclusive or of x and y", "2*mod(xor(x/4, y/4), 32) - 40 - z"),
    "sawtooth": ("Saw teeth along every axis", "mod(x, 48) + mod(y, 64)/2 + 12*mod(z/24, 1) - 70 - z"),
    "sine": ("Sines that cross and overhang", "26*sin(x/40)*sin(y/34) + 14*sin(z/9)*sin((x + y)/30) - z"),
}
LARGEST = 6.0e4  # of a density: what half precision holds
LEAST = 6.0e-8  # what half precision tells from 0
THIRD_PARTY_ERRORS = (ArithmeticError, AttributeError, LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError)


def register(name: str, help: str, maker: Maker) -> None:
    """Add a terrain, or replace one: `maker` turns settings into a function of grids."""
    NAMES[name], _MAKERS[name] = help, maker


@dataclass(frozen=True)
class Sampler:
    """A terrain as boxes ask for it, with what it has answered checked."""

    name: str
    function: Densities

    def bits(self, grid: Grid, repair: bool) -> np.ndarray:
        """1 for set voxels and -1 for others, (X, Y, Z) int8, the paper's one bit a voxel; mended for smoothing where `repair` asks for it.

        Raises:
            GeometryError: as `densities`.
        """
        if not repair:
            is_set = bits_of(self.densities(grid))
        else:
            origin, shape = (tuple(side + more for side in each) for each, more in ((grid.origin, -MARGIN), (grid.shape, 2 * MARGIN)))
            is_set = repaired(bits_of(self.densities(Grid(origin, shape, grid.voxel))))
        return np.where(is_set, np.int8(1), np.int8(-1))

    def densities(self, grid: Grid) -> np.ndarray:
        """Densities (X, Y, Z) float16 of a grid; where there is no number there is no ground.

        Raises:
            GeometryError: when the function fails or answers in another shape.
        """
        try:
            answer = np.asarray(self.function(grid))
            full = np.broadcast_to(answer, grid.shape)
            clipped = np.clip(np.nan_to_num(full, nan=-1.0, posinf=LARGEST, neginf=-LARGEST), -LARGEST, LARGEST)
        except THIRD_PARTY_ERRORS as error:
            raise GeometryError(f'The terrain "{self.name}" fails at {grid.origin} of voxels of {grid.voxel:g}: {error}.') from error
        half = clipped.astype(np.float16)
        lost = (half == 0) & (clipped > 0)
        if lost.any():
            half[lost] = LEAST
        return half


def terrain_of(settings: "ClipboxSettings") -> Sampler:
    """The terrain that `settings` ask for.

    Raises:
        SettingsError, FileError: when its formula or its file cannot be read.
    """
    return Sampler(settings.terrain, _MAKERS[settings.terrain](settings))


def cascades(settings: "ClipboxSettings") -> Densities:
    """Mountains of ridged noise with overhangs, arches, and caves that wind through them."""
    seed, size = 16 * settings.seed, settings.scale

    def densities(grid: Grid) -> np.ndarray:
        _, _, z = grid.axes()
        ridges = fractal(grid, 420.0 * size, 6, seed, gain=0.48, ridged=True, squash=0.6)
        ground = ridges
        ground *= np.float32(110.0 * size)
        ground += fractal(grid, 90.0 * size, 5, seed + 1, gain=0.5) * np.float32(26.0 * size)
        ground -= (z + 165.0 * size).astype(np.float32)
        if grid.voxel > 5.0 * size:  # half as wide as the tunnels: they cannot be seen
            return ground
        tunnels = fractal(grid, 130.0 * size, 2, seed + 2) ** 2
        tunnels += fractal(grid, 110.0 * size, 2, seed + 3, squash=1.5) ** 2
        np.sqrt(tunnels, out=tunnels)
        tunnels -= np.float32(0.12)
        tunnels *= np.float32(60.0 * size)
        return _rounded_minimum(ground, tunnels, np.float32(max(8.0 * size, 3.0 * grid.voxel)))

    return densities


def _rounded_minimum(one: np.ndarray, other: np.ndarray, width: np.float32) -> np.ndarray:
    """The lesser of two densities, and less where they are nearer than `width` to each other: so edges between them are rounded off, which
    voxels would show as saw teeth."""
    near = np.abs(one - other)
    np.subtract(width, near, out=near)
    np.maximum(near, np.float32(0.0), out=near)
    near *= near
    near /= 4.0 * width
    lesser = np.minimum(one, other)
    lesser -= near
    return lesser


def islands(settings: "ClipboxSettings") -> Densities:
    """Rocks that float in layers: rough below, flatter above."""
    seed, size = 16 * settings.seed + 5, settings.scale

    def densities(grid: Grid) -> np.ndarray:
        _, _, z = grid.axes()
        rocks = fractal(grid, 150.0 * size, 5, seed, gain=0.45) * np.float32(70.0 * size)
        place = (z / (130.0 * size) + 0.5) % 1.0 - 0.5  # -0.5 to 0.5 in every layer
        lid = np.where(place > 0.0, 260.0, 70.0) * size * np.abs(place)
        rocks -= (lid + 14.0 * size).astype(np.float32)
        return rocks

    return densities


def spheres(settings: "ClipboxSettings") -> Densities:
    """Spheres of all sizes, added and taken away, as in the paper."""
    size = settings.scale
    field = SphereField(
        largest=settings.sphere_radius * size,
        classes=settings.sphere_classes,
        count=settings.sphere_count,
        taken=settings.sphere_taken,
        height=settings.sphere_height * size,
        seed=settings.seed,
    )
    return lambda grid: carved(grid, spheres_touching(field, grid))


def formula(settings: "ClipboxSettings") -> Densities:
    """What the user types."""
    return _of_formula(settings.formula, settings.scale)


def _of_formula(text: str, scale: float) -> Densities:
    function = Formula(text)
    return lambda grid: function(*(along / scale for along in grid.axes()))


def _preset(text: str) -> Maker:
    return lambda settings: _of_formula(text, settings.scale)


register("cascades", "Ridged mountains with overhangs, arches and caves", cascades)
register("islands", "Rocks that float in layers", islands)
register("spheres", "Spheres of all sizes, added and taken away one after the other", spheres)
register("formula", "A function that you type", formula)
for _name, (_help, _text) in PRESETS.items():
    register(_name, _help, _preset(_text))
