"""The interface between terrain generators and the settings that they read."""

from typing import Protocol


class TerrainSource(Protocol):
    """The description of a terrain, which `ClipboxSettings` implements. Lengths are in scene units.

    terrain: name of the generator. formula: density as a function of x, y and z. source: path of the source file. source_size: longest side
    of the file's content. source_height: height of white above black in a height image. forest_spacing: distance between copies relative
    to source_size. forest_hills: height range of the ground. sphere_radius: radius of the largest class. sphere_classes: number of size
    classes. sphere_count: spheres per cell. sphere_subtracted: fraction that is subtracted. sphere_height: maximum distance from z = 0.
    seed: random seed. scale: size factor of all features.
    """

    terrain: str
    formula: str
    source: str
    source_size: float
    source_height: float
    forest_spacing: float
    forest_hills: float
    sphere_radius: float
    sphere_classes: int
    sphere_count: int
    sphere_subtracted: float
    sphere_height: float
    seed: int
    scale: float
