"""Billboard clouds: a few textured quads per level of detail that replace a mesh or a point cloud.

`build_cloud` finds the quads of all levels; `prepare_trial` and `estimate_by_trial` predict their numbers and sizes.
"""

from .build import build_cloud
from .cloud import AtlasLayout, Cloud, Level, Quads
from .estimate import LevelEstimate
from .settings import BillboardSettings
from .trial import Trial, estimate_by_trial, prepare_trial

__all__ = [
    "AtlasLayout",
    "BillboardSettings",
    "Cloud",
    "Level",
    "LevelEstimate",
    "Quads",
    "Trial",
    "build_cloud",
    "estimate_by_trial",
    "prepare_trial",
]
