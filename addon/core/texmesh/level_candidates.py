"""Candidates for levels of detail: subset levels of a mesh from fine to coarse, made by simplification."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import SettingsError
from ..jobs.progress import Steps, subprogress
from .corner_attributes import CornerAttributes
from .perception.weber import Collapses
from .refitting.outliers import FineSurface
from .refitting.refit import RefitStart, make_starts
from .scale_space.features import ScaleMap
from .settings import TexmeshSettings
from .simplification.levels import Simplification, SubsetLevel, extract_level, simplify_by_cost, simplify_in_order
from .simplification.removal_orders import ScaleWeightedQuadrics
from .textured_mesh import TexturedMesh, merge_wedges

MIN_TRIANGLES = 8  # With fewer triangles there is nothing to simplify. The coarsest candidate has at least half of them.
SMALL_TRIANGLES = 24  # Optimized meshes with fewer triangles, such as boxes, stay as they are: hardly anything could be saved.
STEP = 0.5  # Each candidate has this fraction of the triangles of the one before it.
MIN_FRACTION, FEW_TRIANGLES = 0.01, 64  # The coarsest candidate has this fraction of the triangles, or so many if that is less.
MAX_RATIOS = 32


@dataclass(frozen=True)
class Candidate:
    """A level that is tried.

    Attributes:
        mesh: the level.
        scale: the last scale whose features it has, 0 for the original.
        subset: what it is of the original, None for the original itself.
        start: where its optimization starts, None if it is not optimized.
        distance: no point of it is farther from the original; NaN if that is not known.
        is_moved: whether least squares placed its vertices.
    """

    mesh: TexturedMesh
    scale: int
    subset: SubsetLevel | None
    start: RefitStart | None = None
    distance: float = math.nan
    is_moved: bool = False


@dataclass(frozen=True)
class Candidates:
    """The candidates of a mesh, the original first, and the simplification that made them.

    attributes: of the original, None if the vertices of the candidates stay. Otherwise their subsets refer to a mesh without attributes.
    """

    items: list[Candidate]
    simplification: Simplification
    attributes: CornerAttributes | None

    @property
    def is_optimized(self) -> bool:
        """Whether the vertices of the candidates are to be moved."""
        return self.attributes is not None

    def divide_collapses(self) -> Collapses:
        """Return the collapses; their scales are the indices of the coarsest candidates that contain the removed vertices."""
        counts = [item.subset.collapse_count for item in self.items[1:]]
        used = slice(0, counts[-1] if counts else 0)
        simplification = self.simplification
        removed, kept, values = simplification.removed[used], simplification.kept[used], simplification.perceptual_values[used]
        return Collapses(removed, kept, values, np.searchsorted(counts, np.arange(len(removed)), side="right"))


def min_triangles(settings: TexmeshSettings) -> int:
    """Return how many triangles a mesh needs to be simplified."""
    return SMALL_TRIANGLES if settings.vertices == "optimized" else MIN_TRIANGLES


def make_candidates(mesh: TexturedMesh, scale_map: ScaleMap, ratios: Sequence[float], settings: TexmeshSettings) -> Steps[Candidates]:
    """Simplify a mesh to candidates for levels, each coarser than the one before it.

    ratios: the fractions of the triangles that they have; none for steps of STEP.

    Raises:
        SettingsError: see `targets_of_ratios`.
    """
    wanted = settings.number - 1 if settings.levels == "number" else 0
    if len(mesh.triangles) < min_triangles(settings):
        targets, scales = [], []
    else:
        targets, scales = targets_of_ratios(mesh, scale_map, ratios) if ratios else choose_targets(mesh, scale_map, wanted)
    is_optimized = settings.vertices == "optimized"
    plain = merge_wedges(mesh) if is_optimized else mesh
    attributes = CornerAttributes(mesh, FineSurface.of(plain)) if is_optimized else None
    starts: Sequence[RefitStart | None] = [None] * len(targets)
    if is_optimized:
        simplification, starts = yield from subprogress(make_starts(plain, attributes.source_normals, targets, settings), 0.0, 0.6)
    if is_optimized and settings.removal_order != "scale":
        levels = [start.full for start in starts]
    else:
        simplification = yield from subprogress(_simplify(plain, scale_map, targets, settings), 0.6 if is_optimized else 0.0, 1.0)
        levels = simplification.levels
    items = [Candidate(mesh, 0, None)]
    for level, scale, start in zip(levels, scales, starts, strict=True):
        if 0 < len(level.triangles) < len(items[-1].mesh.triangles):
            subset = extract_level(plain, level)
            items.append(Candidate(subset if attributes is None else attributes.add_to(subset), scale, level, start))
    return Candidates(items, simplification, attributes)


def _simplify(mesh: TexturedMesh, scale_map: ScaleMap, targets: list[int], settings: TexmeshSettings) -> Steps[Simplification]:
    if settings.removal_order == "scale":
        return simplify_in_order(mesh, _priorities(scale_map), targets, settings)
    return simplify_by_cost(
        mesh, lambda divided, vertices: ScaleWeightedQuadrics(divided, scale_map.last_scales[vertices]), targets, settings
    )


def _priorities(scale_map: ScaleMap) -> np.ndarray:
    """Return the order in which vertices are removed, (V,) float64: by last scale, then by strength."""
    rank = np.empty(len(scale_map.strengths))
    rank[np.argsort(scale_map.strengths, kind="stable")] = np.arange(len(rank))
    return scale_map.last_scales + rank / max(len(rank), 1)


def choose_targets(mesh: TexturedMesh, scale_map: ScaleMap, number: int = 0) -> tuple[list[int], list[int]]:
    """Return triangle counts of candidates, descending, and the last scale of which each still has all features.

    number: of candidates, if the mesh has enough triangles; fewer come from STEP.
    """
    total = len(mesh.triangles)
    smallest = max(MIN_TRIANGLES // 2, round(min(MIN_FRACTION * total, FEW_TRIANGLES)))
    count = max(int(math.log(smallest / total, STEP)), 1)
    step = STEP if number <= count else (smallest / total) ** (1.0 / number)
    targets = dict.fromkeys(round(total * step**index) for index in range(1, max(count, number) + 1))
    targets = [target for target in targets if smallest <= target < total]
    return targets, _find_scales(mesh, scale_map, targets)


def _find_scales(mesh: TexturedMesh, scale_map: ScaleMap, targets: Sequence[int]) -> list[int]:
    """Return the last scale of which levels with `targets` triangles still have all features: a mesh without the features below a scale has
    two triangles less per removed vertex, if that is no boundary."""
    total, removed = len(mesh.triangles), len(mesh.vertices) - scale_map.counts
    return [int(max((total - 2 * removed >= target).nonzero()[0], default=0)) for target in targets]


def parse_ratios(text: str) -> list[float]:
    """Return the fractions that `text` lists, "0.5, 0.25" or "50%, 25%", in descending order.

    Raises:
        SettingsError: it lists something else than different fractions between 0 and 1, or more than MAX_RATIOS.
    """
    words = [word.strip() for word in text.split(",")]
    ratios = sorted({_parse_ratio(word, text) for word in words}, reverse=True)
    if len(ratios) < len(words):
        raise SettingsError(f'Ratios are "{text}", which names one twice; write each once.', settings=("ratios",))
    if len(ratios) > MAX_RATIOS:
        raise SettingsError(f"There are {len(ratios)} ratios; the maximum is {MAX_RATIOS}.", settings=("ratios",))
    return ratios


def targets_of_ratios(mesh: TexturedMesh, scale_map: ScaleMap, ratios: Sequence[float]) -> tuple[list[int], list[int]]:
    """Return triangle counts, descending, and the last scale of which each still has all features.

    Raises:
        SettingsError: a ratio leaves no triangle, or two the same number.
    """
    total = len(mesh.triangles)
    targets = [round(ratio * total) for ratio in ratios]
    if targets[-1] < 1 or len(set(targets)) < len(targets):
        raise SettingsError(
            f"A mesh of {total:,} triangles has no level for every ratio; use larger or fewer ratios.", settings=("ratios",)
        )
    return targets, _find_scales(mesh, scale_map, targets)


def _parse_ratio(word: str, text: str) -> float:
    try:
        ratio = float(word.rstrip("% ")) / (100.0 if word.endswith("%") else 1.0)
    except ValueError:
        ratio = math.nan
    if not 0.0 < ratio < 1.0:
        raise SettingsError(
            f'Ratios are "{text}"; write fractions between 0 and 1 separated by commas, as in 0.5,0.25.', settings=("ratios",)
        )
    return ratio
