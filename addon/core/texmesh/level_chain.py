"""Levels of detail of a textured mesh, from its analysis in scale space to the levels that look different from each other.

Sections III.A and IV of the paper: vertices that are features at coarse scales stay longer; a refinement counts if Weber's law and renders
say that it is seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..imaging.mipmaps import Mipmaps, build_mipmaps
from ..jobs.memory import release_memory
from ..jobs.progress import Progress, Result, Steps, subprogress
from .level_candidates import Candidate, Candidates, make_candidates, min_triangles, parse_ratios
from .level_choices import AS_MANY_AS_ASKED, MIN_PIXELS, ComparedCandidates, choose_candidates, compare_candidates, count_bytes, view_levels
from .perception.level_images import LevelImages, measure_difference
from .perception.switch_distances import MIN_IMAGE, Switch, find_shown_levels, find_switches, open_images
from .perception.weber import Impacts
from .refitting.comparison import LevelComparison
from .refitting.outliers import FineSurface
from .refitting.refit import make_starts, refit_starts
from .scale_space.analysis import analyze_scale_space
from .scale_space.features import ScaleMap
from .settings import TexmeshSettings
from .simplification.levels import Simplification, SubsetLevel, extract_level
from .textured_mesh import TexturedMesh

# Fractions of the time after the analysis, the simplification, the comparison and the choice, by the setting *Vertices*.
STAGES = {"optimized": (0.03, 0.11, 0.29, 0.87), "original": (0.03, 0.25, 0.6, 0.65)}
# Fractions of the time of an optimization after a second simplification, and after the refits.
SECOND_SIMPLIFICATION, REFITS = 0.06, 0.62
COMPARED_TRIANGLES = 10_000  # Triangles whose simplification takes as long as the comparisons of a mesh of one.
MAX_RENDERED = 20_000  # Triangles of levels that are compared in renders; larger ones are too near to the original for it to matter.
RENDERED_SIZE, RENDERED_VIEWS = 192, 4  # pixels per side of these renders, and their number


@dataclass(frozen=True)
class Level:
    """One level.

    Attributes:
        mesh: the level.
        scale: the last scale whose features it has; 0 for the original.
        pixel_size: see `perception.switch_distances.Switch`; 0 for the original.
        switch: from where it may replace its finer neighbor, None for the original.
        subset: what it is of the original, before its vertices moved if it is optimized; None for the original itself.
        distance: no point of it is farther from the original, in the unit of the mesh.
        is_moved: whether least squares placed its vertices. Where that would have made it worse, they are those of the simplification.
    """

    mesh: TexturedMesh
    scale: int
    pixel_size: float
    switch: Switch | None
    subset: SubsetLevel | None
    distance: float
    is_moved: bool

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
        return count_bytes(self.mesh)


@dataclass(frozen=True)
class LevelChain:
    """The levels of a mesh.

    Attributes:
        levels: the original first.
        scale_map: the features of the original.
        impacts: how noticeable each refinement is, from a candidate to the one before.
        simplification: the collapses in their order.
        candidates: triangles and pixel sizes of all levels that were tried, finest first.
        image_side: the length that images of the object show.
        distance_factor: of all pixel sizes, see the setting.
    """

    levels: tuple[Level, ...]
    scale_map: ScaleMap
    impacts: Impacts
    simplification: Simplification
    candidates: tuple[tuple[int, float], ...]
    image_side: float
    distance_factor: float = 1.0


def estimate_costs(triangles: np.ndarray, settings: TexmeshSettings) -> np.ndarray:
    """Return the relative times (N,) that `make_levels` takes for meshes with these numbers (N,) of triangles: comparisons of images, which
    hardly depend on them, take most of it."""
    return np.where(triangles < min_triangles(settings), 0.1, np.cbrt(triangles) + triangles / COMPARED_TRIANGLES)


def make_levels(
    mesh: TexturedMesh,
    textures: Sequence[np.ndarray | None],
    settings: TexmeshSettings,
    scale_map: ScaleMap | None = None,
) -> Steps[LevelChain]:
    """Make levels of `mesh`. With fewer than `min_triangles` it is the only one.

    Args:
        textures: per material an image (H, W, 3) float32, scene-linear, row 0 at the bottom, or None. scale_map: of an analysis of the same
            mesh with the same settings, None to analyze it.

    Raises:
        GeometryError: see `analyze_scale_space`.
        SettingsError: the budget allows no level, or a ratio is none.
    """
    ratios = parse_ratios(settings.ratios) if settings.levels == "ratios" else []
    analyzed, simplified, looked_at, finished = STAGES[settings.vertices]
    if scale_map is None:
        scale_map = yield from _run_stage(analyze_scale_space(mesh, textures, settings), 0.0, analyzed)
    mipmaps = [None if texture is None else build_mipmaps(texture) for texture in textures]
    candidates = yield from _run_stage(make_candidates(mesh, scale_map, ratios, settings), analyzed, simplified)
    compared = yield from _run_stage(compare_candidates(candidates, mipmaps, settings), simplified, looked_at)
    yield Progress(looked_at, "Choosing levels")
    chosen = choose_candidates(compared, settings)
    finish = _optimize if candidates.is_optimized else _keep
    kept, images = yield from _run_stage(finish(candidates, compared, chosen, mipmaps, settings), looked_at, finished)
    simplification = candidates.simplification
    del candidates  # Their trees for searches are large.
    find_shown = _show_all if settings.levels in AS_MANY_AS_ASKED else _show_visible
    shown, switches = yield from _run_stage(find_shown(images, settings), finished, 1.0)
    levels = [_to_level(kept[index], switch, settings.distance_factor) for index, switch in zip(shown, [None, *switches], strict=True)]
    tried = tuple(
        (len(item.mesh.triangles), settings.distance_factor * size) for item, size in zip(compared.items, compared.pixel_sizes, strict=True)
    )
    sizes = images[0].frame.side, settings.distance_factor
    return LevelChain(tuple(levels), scale_map, compared.impacts, simplification, tried, *sizes)


def _run_stage(steps: Steps[Result], start: float, stop: float) -> Steps[Result]:
    """Run a part of the work, see `subprogress`, and give back the memory that it leaves."""
    result = yield from subprogress(steps, start, stop)
    release_memory()
    return result


def _keep(
    _candidates: Candidates,
    compared: ComparedCandidates,
    chosen: Sequence[int],
    _mipmaps: Sequence[Mipmaps | None],
    _settings: TexmeshSettings,
) -> Steps[tuple[list[Candidate], list[LevelImages]]]:
    """Return the `chosen` candidates, whose vertices are those of the original, and their images."""
    original, *others = (compared.items[index] for index in chosen)
    comparison = LevelComparison(FineSurface.of(original.mesh))
    kept = [original]
    for index, item in enumerate(others):
        yield Progress(index / len(others), "Measuring levels")
        kept.append(replace(item, distance=comparison.bound_distance(item.mesh)))
    return kept, [compared.images[index] for index in chosen]


def _optimize(
    candidates: Candidates,
    compared: ComparedCandidates,
    chosen: Sequence[int],
    mipmaps: Sequence[Mipmaps | None],
    settings: TexmeshSettings,
) -> Steps[tuple[list[Candidate], list[LevelImages]]]:
    """Return the `chosen` candidates with positions and texture coordinates that deviate least from the original, and their images. Where
    an optimized level is farther from the original, or looks less like it, than the candidate or the level that the optimization began
    with, that one is taken. For small meshes, another optimization begins with levels whose vertices all stayed where they were."""
    del compared.images[1:]  # The optimization needs their memory.
    original, *others = (compared.items[index] for index in chosen)
    attributes = candidates.attributes
    surface, add_to = attributes.surface, attributes.add_to
    comparison, tries = LevelComparison(surface), [[item.start for item in others]]
    if len(surface.mesh.triangles) <= MAX_RENDERED:
        targets = [item.start.target for item in others]
        second = make_starts(surface.mesh, attributes.source_normals, targets, settings, moves_vertices=False)
        tries.append((yield from subprogress(second, 0.0, SECOND_SIMPLIFICATION))[1])
    refits, ends = [], np.linspace(SECOND_SIMPLIFICATION, REFITS, len(tries) + 1).tolist()
    for starts, begin, end in zip(tries, ends[:-1], ends[1:], strict=True):
        refits.append((yield from subprogress(refit_starts(surface, starts), begin, end)))
    kept = [original]
    for index, item in enumerate(others):
        yield Progress(REFITS + (1.0 - REFITS) * index / len(others), "Comparing levels")
        moved = [(refit[index], starts[index].full) for refit, starts in zip(refits, tries, strict=True)]
        limit = max(len(moved[0][0].triangles), item.start.target)
        options = [option for option in moved if len(option[0].triangles) <= limit]
        moved_count = len(options)
        options.append((item.mesh, item.subset))
        if item.subset is not item.start.full:
            options.append((extract_level(surface.mesh, item.start.full), item.start.full))
        meshes, subsets = zip(*options, strict=True)
        differences = None
        if len(item.mesh.triangles) <= MAX_RENDERED:
            meshes = [mesh if mesh is item.mesh else add_to(mesh) for mesh in meshes]
            surfaces = view_levels([replace(item, mesh=mesh) for mesh in meshes], mipmaps, settings)
            images = open_images([compared.images[0].surface, *surfaces], settings, compared.images)
            differences = _measure_differences(images, settings)
        best = comparison.choose(meshes, differences, moved_count)
        mesh = meshes[best] if differences is not None or meshes[best] is item.mesh else add_to(meshes[best])
        kept.append(replace(item, mesh=mesh, subset=subsets[best], distance=comparison.bound_distance(mesh), is_moved=best < moved_count))
    surfaces = [compared.images[0].surface, *view_levels(kept[1:], mipmaps, settings)]
    return kept, open_images(surfaces, settings, compared.images)


def _measure_differences(images: Sequence[LevelImages], settings: TexmeshSettings) -> np.ndarray:
    """Return the mean differences (N - 1,) of all but the first of N levels from the first one, in a few views from all sides."""
    views = np.unique(np.linspace(0, settings.views - 1, RENDERED_VIEWS + 2).round().astype(int)[1:-1])
    return np.array([measure_difference(images[0], image, RENDERED_SIZE, views.tolist()).means.mean() for image in images[1:]])


def _show_all(images: Sequence[LevelImages], settings: TexmeshSettings) -> Steps[tuple[list[int], list[Switch]]]:
    """Return the indices of all levels, and the switch of each but the first."""
    return list(range(len(images))), (yield from find_switches(images, settings, gap=1))


def _show_visible(images: Sequence[LevelImages], settings: TexmeshSettings) -> Steps[tuple[list[int], list[Switch]]]:
    """Return the indices of the levels that are shown from some distance where the object is not too small, and their switches."""
    shown, switches = yield from find_shown_levels(images, settings)
    large = max(1, sum(switch.pixels >= MIN_PIXELS for switch in switches))  # Optimized levels may switch nearer than expected.
    return shown[: 1 + large], switches[:large]


def _to_level(item: Candidate, switch: Switch | None, distance_factor: float) -> Level:
    if switch is None:
        return Level(item.mesh, item.scale, 0.0, None, item.subset, 0.0, item.is_moved)
    pixels = max(round(switch.pixels / distance_factor), MIN_IMAGE)
    switch = replace(switch, pixel_size=distance_factor * switch.pixel_size, pixels=pixels)
    return Level(item.mesh, item.scale, switch.pixel_size, switch, item.subset, item.distance, item.is_moved)
