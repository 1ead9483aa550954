"""Levels of detail of an object from near to far: which of its simplified meshes and billboard clouds show at which distances.

`choose_levels` selects them from all candidates; `combine_levels` gives candidates of several objects that switch together, of which
`choose_vanishing` says which may vanish far away, and `needs_cloud` whether they need a billboard cloud as well.
"""

from .levels import LevelCandidate, choose_levels, choose_vanishing, combine_levels, needs_cloud
from .settings import DistanceSettings

__all__ = ["DistanceSettings", "LevelCandidate", "choose_levels", "choose_vanishing", "combine_levels", "needs_cloud"]
