"""One function per value of the setting *Levels*: which candidates become levels.

Major scales (section IV.A, Figure 11): scale 0 is the finest. Row i - 1 of what describes refinements is the one from scale i to i - 1. A
red refinement is perceptible, a green one is not. Scales that only green refinements separate form a zone, in which the coarsest scale
looks like all others.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import SettingsError
from ..imaging.mipmaps import Mipmaps
from ..jobs.progress import Steps
from ..messages import format_count
from .level_candidates import Candidate, Candidates
from .perception.level_images import LevelImages
from .perception.switch_distances import MIN_SWITCH_RATIO, Switch, SwitchCheck, find_switches, open_images
from .perception.views import ViewedSurface, prepare_surface
from .perception.weber import Impacts, measure_impacts
from .settings import TexmeshSettings
from .textured_mesh import TexturedMesh

MIN_PIXELS = 4  # A level is worth having if the image of the object has so many pixels where it switches.
MIN_STEP = 0.05  # Relative growth of the distance from one scale to the next that counts as a step of the step function.
RANGE_MARGIN = 2.0  # Triangles are averaged over distances from this factor below the nearest switch to this factor beyond the farthest.
AS_MANY_AS_ASKED = ("number", "ratios")  # choices of levels that are all shown from some distance
MAX_LEVELS = 6  # Levels of the perceptual choice, the original included.
VERTEX_BYTES, TRIANGLE_BYTES = 16, 6  # Quantized geometry: position, texture coordinates and normal; indices.


@dataclass(frozen=True)
class ComparedCandidates:
    """Candidates that are worth having, and how they look.

    Attributes:
        items: N candidates, the original first.
        images: N, of the candidates.
        pixel_sizes: N, the smallest size of a pixel in the unit of the object at which each may be shown, 0 for the original.
        impacts: how noticeable each refinement is, from a candidate to the one before.
    """

    items: list[Candidate]
    images: list[LevelImages]
    pixel_sizes: list[float]
    impacts: Impacts


@dataclass(frozen=True)
class LevelOption:
    """A level that can be chosen. pixel_size: the size of a pixel in the object's unit from which it may be shown; 0 for the original."""

    triangles: int
    byte_count: int
    pixel_size: float


@dataclass(frozen=True)
class LevelBudget:
    """What limits the chosen levels; None for no limit.

    count: number of levels. triangles, byte_count: of all chosen levels together.
    """

    count: int | None = None
    triangles: int | None = None
    byte_count: int | None = None


def compare_candidates(candidates: Candidates, mipmaps: Sequence[Mipmaps | None], settings: TexmeshSettings) -> Steps[ComparedCandidates]:
    """Measure how noticeable the candidates are and from where they may be shown, and leave out those that are too small there."""
    items, original = candidates.items, candidates.items[0].mesh
    impacts = measure_impacts(original.vertices, original.triangles, candidates.divide_collapses(), len(items) - 1, settings)
    images = open_images(view_levels(items, mipmaps, settings), settings)
    switches = yield from find_switches(images, settings)
    count = len(items) if settings.levels in AS_MANY_AS_ASKED else _count_useful(switches, candidates.is_optimized)
    return ComparedCandidates(items[:count], images[:count], [0.0, *(switch.pixel_size for switch in switches[: count - 1])], impacts)


def view_levels(levels: Sequence[Candidate], mipmaps: Sequence[Mipmaps | None], settings: TexmeshSettings) -> list[ViewedSurface]:
    """Return levels as renders need them, the original first. mipmaps: of the textures, by material."""
    original = levels[0].mesh if settings.vertices == "original" else None
    return [prepare_surface(level.mesh, mipmaps, settings.shaded, original if index else None) for index, level in enumerate(levels)]


def count_bytes(mesh: TexturedMesh) -> int:
    """Return the bytes of the quantized geometry."""
    return VERTEX_BYTES * len(mesh.uvs) + TRIANGLE_BYTES * len(mesh.triangles)


def _count_useful(switches: Sequence[Switch], is_optimized: bool) -> int:
    """Return the number of candidates that are worth having, the original included: those whose images are not too small where they
    switch, and one more if levels are optimized, after which they look better. There are at least two."""
    large = sum(switch.pixels >= MIN_PIXELS for switch in switches)
    return min(1 + max(large + is_optimized, 1), 1 + len(switches))


def choose_perceptual(compared: ComparedCandidates, settings: TexmeshSettings) -> list[int]:
    """Choose all levels that look different from each other.

    A refinement between neighboring candidates is perceptible if the coarser one is right only from farther away (Figure 11), and if
    Weber's law says so. Others are left out only if renders do not show the difference. Of more than MAX_LEVELS, those stay that have the
    fewest triangles over all distances.
    """
    sizes = compared.pixel_sizes
    is_red = find_red_refinements(np.array(sizes)) & compared.impacts.is_noticed[: len(sizes) - 1]
    zones = find_zones(keep_visible_scales(is_red, SwitchCheck(compared.images, sizes, settings)))
    chosen = [0, *(end for _, end in zones if end)]
    if len(chosen) > MAX_LEVELS:
        options = _list_options(compared)
        chosen = [chosen[index] for index in choose_levels([options[index] for index in chosen], LevelBudget(count=MAX_LEVELS))]
    return skip_finest(chosen, sizes) if settings.vertices == "optimized" else chosen


def choose_number(compared: ComparedCandidates, settings: TexmeshSettings) -> list[int]:
    """Choose a number of levels; where fewer have the fewest triangles over all distances, further ones, the finest first."""
    chosen = choose_levels(_list_options(compared), LevelBudget(count=settings.number))
    others = [index for index in range(len(compared.items)) if index not in chosen]
    return sorted([*chosen, *others[: settings.number - len(chosen)]])


def choose_by_triangles(compared: ComparedCandidates, settings: TexmeshSettings) -> list[int]:
    """Choose levels that have a number of triangles together, without the original."""
    return _choose_coarser(compared, LevelBudget(triangles=settings.max_triangles))


def choose_by_size(compared: ComparedCandidates, settings: TexmeshSettings) -> list[int]:
    """Choose levels that have a number of bytes together, without the original."""
    return _choose_coarser(compared, LevelBudget(byte_count=round(settings.max_size * 1e6)))


def choose_by_pixels(compared: ComparedCandidates, settings: TexmeshSettings) -> list[int]:
    """Choose the levels that are shown while the object has at most a number of pixels."""
    nearest = compared.images[0].frame.side / settings.max_pixels / settings.distance_factor
    start = max(index for index, size in enumerate(compared.pixel_sizes) if size <= nearest)
    return [0, *range(max(start, 1), len(compared.items))]


def choose_all(compared: ComparedCandidates, _settings: TexmeshSettings) -> list[int]:
    """Choose all candidates, which have the wanted ratios."""
    return list(range(len(compared.items)))


CHOICES: dict[str, Callable[[ComparedCandidates, TexmeshSettings], list[int]]] = {
    "perceptual": choose_perceptual,
    "number": choose_number,
    "triangles": choose_by_triangles,
    "size": choose_by_size,
    "pixels": choose_by_pixels,
    "ratios": choose_all,
}


def choose_candidates(compared: ComparedCandidates, settings: TexmeshSettings) -> list[int]:
    """Return the indices of the candidates that become levels, 0 for the original first.

    Raises:
        SettingsError: the budget allows no level.
    """
    return CHOICES[settings.levels](compared, settings) if len(compared.items) > 1 else [0]


def _choose_coarser(compared: ComparedCandidates, budget: LevelBudget) -> list[int]:
    """Return the original and what `budget` allows of the others."""
    return [0, *(1 + index for index in choose_levels(_list_options(compared)[1:], budget))]


def _list_options(compared: ComparedCandidates) -> list[LevelOption]:
    rows = zip(compared.items, compared.pixel_sizes, strict=True)
    return [LevelOption(len(item.mesh.triangles), count_bytes(item.mesh), size) for item, size in rows]


@dataclass(frozen=True)
class _Choice:
    """Chosen levels up to the last one: indices, what they use, and their triangles averaged over the logarithm of the distance."""

    indices: tuple[int, ...]
    triangles: int
    byte_count: int
    cost: float

    def is_no_better_than(self, other: "_Choice") -> bool:
        mine, best = ((len(item.indices), item.triangles, item.byte_count, item.cost) for item in (self, other))
        return all(value >= limit for value, limit in zip(mine, best, strict=True))


def choose_levels(options: Sequence[LevelOption], budget: LevelBudget) -> list[int]:
    """Return the indices of the chosen `options`, finest first.

    The finest level that fits the budget alone is always chosen. Among all choices that fit, it is the one with the smallest mean number of
    triangles over the logarithm of the distance, from the nearest switch to the farthest.

    Args:
        options: finest first, with ascending pixel sizes.

    Raises:
        SettingsError: there are no options, their pixel sizes do not ascend, or the budget allows no level.
    """
    sizes = [option.pixel_size for option in options]
    if not options or sizes != sorted(sizes) or not all(0.0 <= size < math.inf for size in sizes):
        raise SettingsError("Levels to choose from need sizes of pixels from which they are shown that grow from fine to coarse.")
    if budget.count is not None and budget.count < 1:
        raise SettingsError("A budget needs at least one level.")
    singles = [_Choice((index,), option.triangles, option.byte_count, 0.0) for index, option in enumerate(options)]
    fitting = [index for index, choice in enumerate(singles) if _fits(choice, budget)]
    if not fitting:
        smallest = min(options, key=lambda option: option.byte_count)
        triangles = format_count(smallest.triangles, "triangle")
        raise SettingsError(f"The budget is less than the smallest level, {triangles} and {smallest.byte_count} bytes; increase it.")
    positive = [size for size in sizes if size > 0.0] or [1.0]
    logs = [math.log(max(size, positive[0] / RANGE_MARGIN)) for size in sizes]
    farthest = math.log(positive[-1] * RANGE_MARGIN)
    first = fitting[0]
    frontier = {first: [singles[first]]}
    for last in fitting[1:]:
        option = options[last]
        grown = []
        for choices in frontier.values():
            for choice in choices:
                previous = choice.indices[-1]
                cost = choice.cost + options[previous].triangles * (logs[last] - logs[previous])
                triangles, byte_count = choice.triangles + option.triangles, choice.byte_count + option.byte_count
                grown.append(_Choice((*choice.indices, last), triangles, byte_count, cost))
        frontier[last] = _drop_dominated([choice for choice in grown if _fits(choice, budget)])
    complete = [choice for choices in frontier.values() for choice in choices]

    def total_cost(choice: _Choice) -> tuple[float, int]:
        return choice.cost + options[choice.indices[-1]].triangles * (farthest - logs[choice.indices[-1]]), len(choice.indices)

    return list(min(complete, key=total_cost).indices)


def _fits(choice: _Choice, budget: LevelBudget) -> bool:
    return (
        (budget.count is None or len(choice.indices) <= budget.count)
        and (budget.triangles is None or choice.triangles <= budget.triangles)
        and (budget.byte_count is None or choice.byte_count <= budget.byte_count)
    )


def _drop_dominated(choices: list[_Choice]) -> list[_Choice]:
    """Return the choices that end with the same level without those that are no better than another in any respect."""
    kept: list[_Choice] = []
    for choice in sorted(choices, key=lambda choice: (choice.cost, choice.triangles, choice.byte_count, len(choice.indices))):
        if not any(choice.is_no_better_than(other) for other in kept):
            kept.append(choice)
    return kept


def skip_finest(chosen: Sequence[int], pixel_sizes: Sequence[float]) -> list[int]:
    """Return the `chosen` indices, 0 for the original first, without the next one if another follows so closely that it would be hardly
    shown. Refitting it would take as long as all others, and after refits the coarser one is shown from nearer still.

    pixel_sizes: of all levels, those from which they may be shown.
    """
    is_close = len(chosen) > 2 and pixel_sizes[chosen[2]] < MIN_SWITCH_RATIO * pixel_sizes[chosen[1]]
    return [chosen[0], *chosen[2 if is_close else 1 :]]


def find_red_refinements(distances: np.ndarray, min_step: float = MIN_STEP) -> np.ndarray:
    """Return which refinements (S,) bool are perceptible, from the nearest distance (S + 1,) at which each scale looks right.

    Where the step function is flat, the coarser scale serves from the same distance on: the refinement is imperceptible.

    Raises:
        SettingsError: distances are negative, not finite, or not ascending.
    """
    check_distances(distances)
    return np.diff(distances) > min_step * distances[:-1]


def check_distances(distances: np.ndarray) -> None:
    """Check distances (S + 1,) of scales from the finest to the coarsest.

    Raises:
        SettingsError: they are negative, not finite, or not ascending.
    """
    if not len(distances) or not np.isfinite(distances).all() or distances[0] < 0.0 or (np.diff(distances) < 0.0).any():
        raise SettingsError("The distances of scales must be finite numbers from 0 on that do not decrease towards coarse scales.")


def find_major_scales(is_red: np.ndarray) -> np.ndarray:
    """Return the major scale (S + 1,) that replaces each scale: the coarsest one of its zone. A scale between two red refinements is its
    own."""
    scale_count = len(is_red) + 1
    ends = np.flatnonzero(np.append(is_red, True))  # the coarsest scales of zones
    return ends[np.searchsorted(ends, np.arange(scale_count))]


def find_zones(is_red: np.ndarray) -> list[tuple[int, int]]:
    """Return the zones as pairs of their finest and coarsest scale, from fine to coarse."""
    ends = np.unique(find_major_scales(is_red))
    return [(int(start), int(end)) for start, end in zip(np.append(0, ends[:-1] + 1), ends, strict=True)]


def keep_visible_scales(is_red: np.ndarray, looks_same: Callable[[int, int], bool]) -> np.ndarray:
    """Return which refinements (S,) bool are perceptible after a physical check: a scale is dropped only if that cannot be seen.

    Args:
        is_red: (S,) bool, by Weber's law or judges. looks_same: whether a coarse scale (second argument) looks like a fine one (first) at
            the distance from which the fine one is shown, such as by `SwitchCheck`. It is asked only about scales of one zone.
    """
    checked = np.array(is_red, bool)
    for start, end in find_zones(checked):
        coarse = end
        while coarse > start:
            fine = coarse - 1
            while fine >= start and looks_same(fine, coarse):
                fine -= 1
            if fine >= start:
                checked[fine] = True  # the refinement from scale fine + 1 to fine
            coarse = fine
    return checked
