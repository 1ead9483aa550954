"""Low-stretch UV maps with more texels where they are seen.

`unwrap` cuts, parameterizes and packs a surface; `compute_importance` determines where texels are needed.
"""

from .importance import compute_importance
from .settings import UnwrapSettings
from .unwrapping import UnwrapResult, unwrap

__all__ = ["UnwrapResult", "UnwrapSettings", "compute_importance", "unwrap"]
