"""Levels of detail of a textured mesh, from its analysis in scale space to the levels that look different from each other.

Sections III.A and IV of the paper: vertices that are features at coarse scales stay longer; a refinement counts if Weber's law and renders
say that it is seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import GeometryError
from ..geometry.transforms import signed_areas
from ..imaging.mipmaps import Mipmaps, build_mipmaps
from ..jobs.parallel_steps import run_in_parallel
from ..jobs.progress import Progress, Steps, subprogress
from .perception.level_choice import LevelBudget, LevelOption, choose_levels, skip_finest
from .perception.level_images import LevelImages
from .perception.major_scales import find_red_refinements, find_zones, keep_visible_scales
from .perception.settings import PerceptionSettings
from .perception.switch_distances import Switch, SwitchCheck, find_shown_levels, find_switches, open_images
from .perception.views import ViewedSurface, prepare_surface
from .perception.weber import Collapses, Impacts, measure_impacts
from .ratios import parse_ratios, targets_of_ratios
from .refitting.refit import make_starts, refit_starts
from .refitting.settings import RefitSettings
from .scale_space.analysis import analyze_scale_space
from .scale_space.scale_map import SCALES, ScaleMap
from .scale_space.settings import ScaleSpaceSettings
from .settings import LevelSettings
from .simplification.levels import Simplification, SubsetLevel, extract_level, simplify_by_cost, simplify_in_order
from .simplification.removal_orders import ScaleWeightedQuadrics
from .simplification.settings import SimplificationSettings
from .textured_mesh import TexturedMesh

MIN_TRIANGLES = 8  # of the source, below which there is nothing to simplify, and of the coarsest level that is tried
MIN_REDUCTION = 0.6  # of triangles from one candidate to the next
STEP_BEYOND = 0.5  # of triangles from one candidate to the next beyond the last scale
MIN_FRACTION = 0.002  # of the triangles of the source in the coarsest candidate
MIN_PIXELS = 4  # of the image of an object at the switch to a level that is worth having
VERTEX_BYTES, TRIANGLE_BYTES = 16, 6  # of quantized geometry: position, texture coordinates and normal; indices


@dataclass(frozen=True)
class AllSettings:
    """The settings of all parts."""

    levels: LevelSettings
    analysis: ScaleSpaceSettings
    simplification: SimplificationSettings
    perception: PerceptionSettings


@dataclass(frozen=True)
class Level:
    """One level. scale: the last scale whose features it has; 0 for the original. pixel_size: see
    `perception.switch_distances.Switch`, 0 for the original. switch, subset: None for the original. With the product "refit", `subset` is
    the level before its vertices moved."""

    mesh: TexturedMesh
    scale: int
    pixel_size: float
    switch: Switch | None
    subset: SubsetLevel | None

    @property
    def constraint(self) -> str:
        """See `SubsetLevel`."""
        return "" if self.subset is None else self.subset.constraint

    @property
    def drastic_steps(self) -> tuple[str, ...]:
        """See `SubsetLevel`."""
        return () if self.subset is None else self.subset.drastic_steps

    @property
    def byte_count(self) -> int:
        """Bytes of the quantized geometry."""
        return VERTEX_BYTES * len(self.mesh.uvs) + TRIANGLE_BYTES * len(self.mesh.triangles)


@dataclass(frozen=True)
class LevelChain:
    """The levels of a mesh, the original first.

    candidates: triangles and pixel sizes of all levels that were tried, finest first. impacts: how noticeable each refinement is, from a
    candidate to the one before. simplification: the collapses in their order. image_side: the length that images of the object show.
    """

    levels: tuple[Level, ...]
    scale_map: ScaleMap
    impacts: Impacts
    simplification: Simplification
    candidates: tuple[tuple[int, float], ...]
    image_side: float


@dataclass(frozen=True)
class _Candidate:
    """A level that is tried. start, target: from what a refit level is made, and its triangles; None and 0 if it is not."""

    mesh: TexturedMesh
    scale: int
    subset: SubsetLevel | None
    start: SubsetLevel | None = None
    target: int = 0


def make_levels(
    mesh: TexturedMesh,
    textures: Sequence[np.ndarray | None],
    settings: AllSettings,
    name: str = "mesh",
    scale_map: ScaleMap | None = None,
) -> Steps[LevelChain]:
    """Make levels of `mesh`.

    Args:
        textures: per material an image (H, W, 3) float32, scene-linear, row 0 at the bottom, or None. name: for messages. scale_map: of an
            analysis of the same mesh with the same settings, None to analyze it.

    Raises:
        GeometryError: there is nothing to simplify.
        SettingsError: the budget allows no level, or a ratio is none.
    """
    if len(mesh.triangles) < MIN_TRIANGLES:
        raise GeometryError(f'"{name}" has only {len(mesh.triangles)} triangles; levels need at least {MIN_TRIANGLES}.')
    levels = settings.levels
    ratios = parse_ratios(levels.ratio) if levels.choice == "ratio" else []
    if scale_map is None:
        scale_map = yield from subprogress(analyze_scale_space(mesh, textures, settings.analysis), 0.0, 0.35)
    mipmaps = [None if texture is None else build_mipmaps(texture) for texture in textures]
    targets, scales = targets_of_ratios(mesh, scale_map, ratios) if ratios else choose_targets(mesh, scale_map)
    is_refit = levels.product == "refit" and _has_uv_area(mesh)
    tasks: list[Steps] = [_simplify(mesh, scale_map, targets, settings)]
    if is_refit:
        tasks.append(make_starts(mesh, targets, RefitSettings(), settings.simplification))
    simplification, *starts = yield from subprogress(run_in_parallel(tasks), 0.35, 0.6)
    candidates = _gather_candidates(mesh, simplification, scales, targets, starts[0] if is_refit else [None] * len(targets))
    collapses = _divide_collapses(simplification, candidates)
    impacts = measure_impacts(mesh.vertices, mesh.triangles, collapses, len(candidates) - 1, settings.perception)
    images = open_images(_view(candidates, mipmaps, settings.perception), settings.perception)
    switches = yield from subprogress(find_switches(images, settings.perception), 0.6, 0.8)
    yield Progress(0.8, "Choosing levels")
    useful = len(candidates) if ratios else _count_useful(switches, is_refit)
    candidates, images = candidates[:useful], images[:useful]
    pixel_sizes = [0.0, *(switch.pixel_size for switch in switches[: useful - 1])]
    chosen = _choose(candidates, pixel_sizes, impacts, images, settings)
    kept, images = [candidates[index] for index in chosen], [images[index] for index in chosen]
    if is_refit:
        images = images[:1]  # refits need the memory of the others
        kept = yield from subprogress(_refit(mesh, kept), 0.8, 0.95)
        images = open_images(_view(kept, mipmaps, settings.perception), settings.perception, images)
    if levels.choice in ("count", "ratio"):  # as many levels as were asked for
        switches = yield from subprogress(find_switches(images, settings.perception, gap=1), 0.95, 1.0)
    else:
        shown, switches = yield from subprogress(find_shown_levels(images, settings.perception), 0.95, 1.0)
        large = max(1, sum(switch.pixels >= MIN_PIXELS for switch in switches))  # refitted levels may switch nearer than expected
        shown, switches = shown[: 1 + large], switches[:large]
        kept = [kept[index] for index in shown]
    made = [_to_level(item, switch) for item, switch in zip(kept, [None, *switches], strict=True)]
    tried = tuple((len(item.mesh.triangles), size) for item, size in zip(candidates, pixel_sizes, strict=True))
    return LevelChain(tuple(made), scale_map, impacts, simplification, tried, images[0].frame.side)


def choose_targets(mesh: TexturedMesh, scale_map: ScaleMap) -> tuple[list[int], list[int]]:
    """Return triangle counts of candidates, descending, and the scale whose features each has.

    A mesh without the features below a scale has two triangles less per removed vertex, if that is no boundary. Beyond the last scale, the
    strongest features stay.
    """
    total, vertices = len(mesh.triangles), len(mesh.vertices)
    smallest = max(MIN_TRIANGLES // 2, round(MIN_FRACTION * total))
    targets, scales, last = [], [], total
    for scale in range(1, SCALES):
        count = max(total - 2 * (vertices - int(scale_map.counts[scale])), smallest)
        if count <= MIN_REDUCTION * last:
            targets.append(count)
            scales.append(scale)
            last = count
    while last * STEP_BEYOND >= smallest:
        last = max(round(last * STEP_BEYOND), 1)
        targets.append(last)
        scales.append(SCALES - 1)
    return targets, scales


def _count_useful(switches: Sequence[Switch], is_refit: bool) -> int:
    """Return the number of candidates that are worth having, the original included: those whose images are not too small where they
    switch, and one more if levels are refitted, after which they look better. There are at least two."""
    large = sum(switch.pixels >= MIN_PIXELS for switch in switches)
    return min(1 + max(large + is_refit, 1), 1 + len(switches))


def _has_uv_area(mesh: TexturedMesh) -> bool:
    """Return whether a triangle has an area in UV space, without which nothing can be refitted."""
    return bool(signed_areas(mesh.corner_uvs).any())


def _priorities(scale_map: ScaleMap) -> np.ndarray:
    """Return the order in which vertices are removed, (V,) float64: by last scale, then by strength."""
    rank = np.empty(len(scale_map.strengths))
    rank[np.argsort(scale_map.strengths, kind="stable")] = np.arange(len(rank))
    return scale_map.last_scales + rank / max(len(rank), 1)


def _divide_collapses(simplification: Simplification, candidates: Sequence[_Candidate]) -> Collapses:
    """Return the collapses; their scales are the indices of the coarsest candidates that contain the removed vertices."""
    counts = [item.subset.collapse_count for item in candidates[1:]]
    used = slice(0, counts[-1] if counts else 0)
    removed, kept, values = simplification.removed[used], simplification.kept[used], simplification.perceptual_values[used]
    return Collapses(removed, kept, values, np.searchsorted(counts, np.arange(len(removed)), side="right"))


def _simplify(mesh: TexturedMesh, scale_map: ScaleMap, targets: list[int], settings: AllSettings) -> Steps[Simplification]:
    if settings.levels.order == "scale":
        return (yield from simplify_in_order(mesh, _priorities(scale_map), targets, settings.simplification))
    return (yield from simplify_by_cost(mesh, ScaleWeightedQuadrics(mesh, scale_map), targets, settings.simplification))


def _gather_candidates(
    mesh: TexturedMesh,
    simplification: Simplification,
    scales: Sequence[int],
    targets: Sequence[int],
    starts: Sequence[SubsetLevel | None],
) -> list[_Candidate]:
    """Return the original and the levels that are coarser than the ones before them."""
    candidates = [_Candidate(mesh, 0, None)]
    for level, scale, target, start in zip(simplification.levels, scales, targets, starts, strict=True):
        if 0 < len(level.triangles) < len(candidates[-1].mesh.triangles):
            candidates.append(_Candidate(extract_level(mesh, level), scale, level, start, target))
    return candidates


def _view(levels: Sequence[_Candidate], mipmaps: Sequence[Mipmaps | None], settings: PerceptionSettings) -> list[ViewedSurface]:
    return [prepare_surface(level.mesh, mipmaps, settings.is_lit) for level in levels]


def _choose(
    candidates: Sequence[_Candidate],
    pixel_sizes: Sequence[float],
    impacts: Impacts,
    images: Sequence[LevelImages],
    settings: AllSettings,
) -> list[int]:
    """Return the indices of the levels to keep, 0 for the original first. images: of the candidates."""
    if len(candidates) < 2:
        return [0]
    levels, side = settings.levels, images[0].frame.side
    if levels.choice == "ratio":
        return list(range(len(candidates)))
    if levels.choice == "perceptual":
        ends = [end for _, end in find_zones(_find_red(pixel_sizes, impacts, images, settings.perception))]
        chosen = [0, *(end for end in ends if end)]
        return skip_finest(chosen, pixel_sizes) if levels.product == "refit" else chosen
    options = [
        LevelOption(len(item.mesh.triangles), _to_level(item, None).byte_count, size)
        for item, size in zip(candidates, pixel_sizes, strict=True)
    ]
    if levels.choice == "count":
        return choose_levels(options, LevelBudget(count=levels.levels))
    if levels.choice == "pixels":
        nearest = side / levels.max_pixels
        start = max(index for index, size in enumerate(pixel_sizes) if size <= nearest)
        return sorted({0, *range(start, len(candidates))} if start else set(range(len(candidates))))
    is_size = levels.choice == "size"
    budget = LevelBudget(byte_count=round(levels.max_size * 1e6)) if is_size else LevelBudget(triangles=levels.max_triangles)
    return [0, *(1 + index for index in choose_levels(options[1:], budget))]


def _find_red(pixel_sizes: Sequence[float], impacts: Impacts, images: Sequence[LevelImages], settings: PerceptionSettings) -> np.ndarray:
    """Return which refinements between neighboring candidates are perceptible, (N - 1,) bool.

    They are if the coarser one is right only from farther away (Figure 11), and if Weber's law says so. Others are left out only if renders
    do not show the difference.
    """
    is_red = find_red_refinements(np.array(pixel_sizes)) & impacts.is_noticed[: len(pixel_sizes) - 1]
    return keep_visible_scales(is_red, SwitchCheck(images, pixel_sizes, settings))


def _refit(mesh: TexturedMesh, kept: Sequence[_Candidate]) -> Steps[list[_Candidate]]:
    """Return levels with as many triangles whose positions and texture coordinates deviate least from `mesh`."""
    starts, targets = [item.start for item in kept[1:]], [item.target for item in kept[1:]]
    moved = yield from refit_starts(mesh, starts, targets, RefitSettings())
    return [kept[0], *(replace(item, mesh=level) for item, level in zip(kept[1:], moved, strict=True))]


def _to_level(item: _Candidate, switch: Switch | None) -> Level:
    return Level(item.mesh, item.scale, 0.0 if switch is None else switch.pixel_size, switch, item.subset)
