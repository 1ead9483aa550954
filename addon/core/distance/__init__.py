"""Levels of detail of an object from near to far: which of its simplified meshes and billboard clouds show at which distances.

`choose_levels` selects them from all candidates; `combine_levels` gives candidates of several objects that switch together, of which
`choose_vanishing` says which may vanish far away, and `is_light` whether more levels or a billboard cloud would not pay.
"""

from .levels import LevelCandidate, choose_levels, choose_vanishing, combine_levels, is_light
from .settings import DistanceSettings

__all__ = ["DistanceSettings", "LevelCandidate", "choose_levels", "choose_vanishing", "combine_levels", "is_light"]
