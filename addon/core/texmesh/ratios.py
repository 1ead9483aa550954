"""Levels with given fractions of the triangles of a mesh."""

import math

from ..errors import SettingsError
from .scale_space.scale_map import ScaleMap
from .textured_mesh import TexturedMesh

MAX_RATIOS = 32


def parse_ratios(text: str) -> list[float]:
    """Return the fractions that `text` lists, "0.5, 0.25" or "50%, 25%", in descending order.

    Raises:
        SettingsError: it lists something else than different fractions between 0 and 1, or more than MAX_RATIOS.
    """
    words = [word.strip() for word in text.split(",")]
    ratios = sorted({_parse_ratio(word, text) for word in words}, reverse=True)
    if len(ratios) < len(words):
        raise SettingsError(f'Ratios are "{text}", which names one twice; write each once.', settings=("ratio",))
    if len(ratios) > MAX_RATIOS:
        raise SettingsError(f"There are {len(ratios)} ratios; the maximum is {MAX_RATIOS}.", settings=("ratio",))
    return ratios


def targets_of_ratios(mesh: TexturedMesh, scale_map: ScaleMap, ratios: list[float]) -> tuple[list[int], list[int]]:
    """Return triangle counts, descending, and the last scale of which each still has all features, see `level_chain.choose_targets`.

    Raises:
        SettingsError: a ratio leaves no triangle, or two the same number.
    """
    total, removed = len(mesh.triangles), len(mesh.vertices) - scale_map.counts
    targets = [round(ratio * total) for ratio in ratios]
    if targets[-1] < 1 or len(set(targets)) < len(targets):
        raise SettingsError(f"A mesh of {total:,} triangles has no level for every ratio; use larger or fewer ratios.", settings=("ratio",))
    scales = [int(max((total - 2 * removed >= target).nonzero()[0], default=0)) for target in targets]
    return targets, scales


def _parse_ratio(word: str, text: str) -> float:
    try:
        ratio = float(word.rstrip("% ")) / (100.0 if word.endswith("%") else 1.0)
    except ValueError:
        ratio = math.nan
    if not 0.0 < ratio < 1.0:
        raise SettingsError(
            f'Ratios are "{text}"; write fractions between 0 and 1 separated by commas, as in 0.5,0.25.', settings=("ratio",)
        )
    return ratio
