"""Relightable textures of billboard clouds: view- and light-dependent appearance, compressed and decoded.

`RelightableTexture` decodes a level for any view and light, `write_fmf` writes it as a `.btf` file, and `estimate_bake` predicts the
cost of a bake. A bake itself needs Blender.
"""

from .decoding import RelightableTexture
from .estimate import BakeEstimate, LevelExtent, estimate_bake
from .formats.fmf import write_fmf
from .settings import BtfSettings

__all__ = ["BakeEstimate", "BtfSettings", "LevelExtent", "RelightableTexture", "estimate_bake", "write_fmf"]
