"""The figures that are stored with levels, read back: what is plotted, and how strong the difference of each level is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import SettingsError
from ..json_values import parse_json

MAX_FIGURES = 10_000  # Limit of the figures of each kind.


@dataclass(frozen=True)
class LevelFigures:
    """Figures about levels and how they were made.

    Attributes:
        features: (21,) vertices that are features at each scale or a later one.
        ranges: (21,), Figure 10.
        candidate_triangles, candidate_sizes: of all levels that were tried, finest first; sizes are pixel sizes in the unit of the mesh.
        weber_fractions: of the refinement to each candidate from the next one.
        level_triangles: of the levels, the original first.
        distance_factor: of the distances from which they are shown.
    """

    features: np.ndarray
    ranges: np.ndarray
    candidate_triangles: np.ndarray
    candidate_sizes: np.ndarray
    weber_fractions: np.ndarray
    level_triangles: np.ndarray
    distance_factor: float

    @property
    def stimuli(self) -> np.ndarray:
        """The Weber fraction of each level but the original: the largest of the refinements between the original and it."""
        candidates = [int(np.argmin(np.abs(self.candidate_triangles - count))) for count in self.level_triangles[1:]]
        return np.array([self.weber_fractions[: max(candidate, 1)].max(initial=0.0) for candidate in candidates])


def read_figures(text: object) -> LevelFigures:
    """Return the figures in a JSON text.

    Raises:
        SettingsError: it is damaged.
    """
    try:
        content = parse_json(text) if isinstance(text, str) else None
    except ValueError:
        content = None
    if not isinstance(content, dict):
        raise SettingsError("The figures of the levels are damaged; make the levels again.")
    candidates, levels = content.get("candidates"), content.get("levels")
    return LevelFigures(
        features=_read_numbers(content.get("features")),
        ranges=_read_numbers(content.get("ranges")),
        candidate_triangles=_read_column(candidates, "triangles"),
        candidate_sizes=_read_column(candidates, "pixel_size"),
        weber_fractions=_read_numbers(content.get("weber_fractions")),
        level_triangles=_read_column(levels, "triangles"),
        distance_factor=_read_factor(content.get("distance_factor", 1.0)),
    )


def _read_column(rows: object, name: str) -> np.ndarray:
    return _read_numbers([row.get(name) if isinstance(row, dict) else None for row in rows] if isinstance(rows, list) else None)


def _read_numbers(values: object) -> np.ndarray:
    """Return a list of JSON as an array (N,) float64."""
    if not isinstance(values, list) or not 0 < len(values) <= MAX_FIGURES or not all(map(_is_number, values)):
        raise SettingsError("The figures of the levels are damaged; make the levels again.")
    return np.array(values, np.float64)


def _read_factor(value: object) -> float:
    factor = float(_read_numbers([value])[0])
    if factor <= 0.0:
        raise SettingsError("The figures of the levels are damaged; make the levels again.")
    return factor


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and abs(value) < 1e300


def step_function(sizes: Sequence[float]) -> list[tuple[float, float]]:
    """Return the corners (pixel size, index) of the function from the size of a pixel to the coarsest candidate that looks right there
    (Figure 11). sizes: of the candidates, the original first, whose size does not count."""
    corners, index = [], 0
    order = sorted(range(1, len(sizes)), key=lambda candidate: (sizes[candidate], candidate))
    for candidate in order:
        if candidate > index:
            corners += [(float(sizes[candidate]), float(index)), (float(sizes[candidate]), float(candidate))]
            index = candidate
    return corners
