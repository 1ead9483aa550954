"""Billboard clouds: a few textured quads per level of detail that replace a mesh or a point cloud.

`build_cloud` finds the quads of all levels; `sample_geometry` and `estimate_levels` predict their numbers and sizes.
"""

from .build import build_cloud
from .cloud import AtlasLayout, Cloud, Level, Quads
from .estimate import LevelEstimate, SurfaceSample, estimate_levels, sample_geometry
from .settings import BillboardSettings

__all__ = [
    "AtlasLayout",
    "BillboardSettings",
    "Cloud",
    "Level",
    "LevelEstimate",
    "Quads",
    "SurfaceSample",
    "build_cloud",
    "estimate_levels",
    "sample_geometry",
]
