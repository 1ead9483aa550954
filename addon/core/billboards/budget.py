"""Budgets: search for the error that meets a number of quads, of triangles or of megabytes of texture.

Loose parts and connected surfaces, such as leaves and trunk, are two groups. Each gets a fraction of the budget and an error of its own. A
group that cannot use up its fraction leaves the rest to the other; if a group needs more than its fraction, both use the same error. A
level is the union of both groups and has the larger of the two errors, because it is indistinguishable from the source only from that
error's distance on; all its texels have the size that follows from this error.

Where not even the largest error meets the budget, the limits on normals and texture waste give way: the quads are then slabs along the six
directions of the axes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import SettingsError
from ..jobs.progress import Steps, subprogress
from .atlas import MAX_TEXELS
from .cloud import Level
from .clustering.patches import Covering, merge_coverings
from .clustering.slabs import MIN_SLABS, cover_with_slabs
from .error_search import MAX_ERROR, MIN_FRACTION, Attempt, search_error
from .estimate import BYTES_PER_TEXEL, estimate_levels, sample_primitives
from .levels import LevelBuilder
from .lightness import keep_lighter_levels
from .primitives import Components, Primitives
from .settings import BillboardSettings

MAX_REMAINING_BUILDS = 4  # Maximum builds of the group that gets the unused rest of the budget.
MIN_AREA_FRACTION = 0.05  # The quads of a group are weighed against at least this fraction of the total area.
MIN_BUDGET_FRACTION = 1e-9  # Replaces 0 as a divisor.
QUADS_EXPONENT = 1.2  # The number of quads grows with this power of 1 / error, measured on heads and trees.
TEXTURE_EXPONENT = 2.0  # The same for texels, which have two sides.
MIN_TEXEL_LIMIT, TEXELS_PER_QUAD = 2**22, 2**16  # Limits of a texture with a budget of quads: a few more quads are not worth any texture.
GROUP_PROGRESS = 0.3  # The search of one group takes this fraction of the allocation's progress; the second search takes the rest.
MIN_SLAB_ERROR = 0.1  # Relative error of the result of a search, from which on slabs are tried.
MAX_SLAB_RATIO = 2.0  # A search whose error is larger than this many times that of slabs has failed.
MAX_SLAB_QUADS = 1024  # The first number of slabs for other budgets than quads.
COARSE_LEVELS_PROGRESS = 0.2  # Levels above those that count for the budget take this fraction of the progress.


@dataclass(frozen=True)
class Budget:
    """Either quads or triangles of the finest level, or megabytes of texture of all levels; the others are 0."""

    quads: int = 0
    megabytes: float = 0.0
    triangles: int = 0

    @property
    def limit(self) -> float:
        """Maximum usage, in the unit of `measure_usage`."""
        return self.quads or self.triangles or self.megabytes

    @property
    def exponent(self) -> float:
        """The usage is about proportional to the error to the power of -`exponent`."""
        return TEXTURE_EXPONENT if self.megabytes else QUADS_EXPONENT

    @property
    def setting(self) -> tuple[str, str]:
        """Field name and label of the setting."""
        return next(item for item in BUDGETS if getattr(self, BUDGETS[item]))

    @property
    def max_texels(self) -> int:
        """The largest texture of a level. Ever smaller errors may add a last few quads while the texture grows without limit."""
        quads = self.quads or self.triangles // 2
        return MAX_TEXELS if self.megabytes else min(MAX_TEXELS, max(MIN_TEXEL_LIMIT, TEXELS_PER_QUAD * quads))

    def count_measured_levels(self, levels: int) -> int:
        """Return how many of the `levels` of a cloud, from the finest on, count for the budget."""
        return levels if self.megabytes else 1

    def measure_usage(self, levels: Sequence[Level]) -> float:
        """Return the quads or triangles of the first of `levels`, or the megabytes of all in Blender, including gutters and all maps."""
        if self.triangles:
            return levels[0].triangle_count
        return levels[0].quad_count if self.quads else texture_megabytes(sum(math.prod(level.atlas.size) for level in levels))

    def replace_in_settings(self, settings: BillboardSettings, limit: float) -> BillboardSettings:
        """Return `settings` with `limit`, positive, as the budget in the same unit."""
        return replace(settings, **{self.setting[0]: limit if self.megabytes else max(1, int(limit))})

    def format_amount(self, amount: float) -> str:
        """Return `amount` with its unit for messages, rounded up."""
        if not self.megabytes:
            return f"{math.ceil(amount)} {'quads' if self.quads else 'triangles'}"
        return f"{math.ceil(amount * 1000.0) / 1000.0:g} MB of texture"


BUDGETS = {("quads", "Quads"): "quads", ("triangles", "Triangles"): "triangles", ("texture_mb", "Texture MB"): "megabytes"}


def read_budget(settings: BillboardSettings) -> Budget | None:
    """Return the budget of `settings`, or None if they use an error.

    Raises:
        SettingsError: several budgets are set.
    """
    given = {item: getattr(settings, item[0]) for item in BUDGETS if getattr(settings, item[0])}
    if len(given) > 1:
        values = " and ".join(f"{label} is {value:g}" for (_, label), value in given.items())
        raise SettingsError(f"{values}; set only one budget and leave the other 0.", tuple(name for name, _ in given))
    return next((Budget(**{BUDGETS[item]: value}) for item, value in given.items()), None)


def texture_megabytes(texels: int) -> float:
    """Return the memory of all maps of a texture with this number of `texels`."""
    return texels * BYTES_PER_TEXEL / 1e6


@dataclass(frozen=True)
class BudgetGroup:
    """Primitives that share one error and one fraction of the budget.

    indices (K,): of the primitives among all. primitives, components: of these K. fraction: of the budget, 0..1.
    """

    indices: np.ndarray
    primitives: Primitives
    components: Components
    fraction: float


def split_into_groups(primitives: Primitives, components: Components, loose_fraction: float) -> list[BudgetGroup]:
    """Split into loose parts and connected surfaces, or return one group if there is only one of them.

    The first group has fewer primitives for its fraction of the budget, and is thus more likely to leave some of it.
    """
    loose = components.loose
    if loose.all() or not loose.any():
        return [BudgetGroup(np.arange(len(primitives)), primitives, components, 1.0)]
    members = ((np.flatnonzero(loose), loose_fraction), (np.flatnonzero(~loose), 1.0 - loose_fraction))
    groups = [BudgetGroup(indices, primitives.subset(indices), components.subset(indices), fraction) for indices, fraction in members]
    return sorted(groups, key=lambda group: len(group.indices) / max(group.fraction, MIN_BUDGET_FRACTION))


def cover_within_budget(
    primitives: Primitives, components: Components, builder: LevelBuilder, budget: Budget, name: str
) -> Steps[tuple[list[Covering], float]]:
    """Build the coverings of all levels so that their usage is close to `budget` but not above it.

    Returns:
        The coverings, and the relative error of the finest level: the larger one of its groups.

    Raises:
        SettingsError: even the largest error exceeds the budget; the message contains `name`.
    """
    search = _BudgetSearch(primitives, components, builder, budget)
    allocation = yield from subprogress(search.allocate(), 0.0, 1.0 - COARSE_LEVELS_PROGRESS)
    usage, error = search.measure(allocation), max_relative_error(allocation)
    if usage > budget.limit or error > MIN_SLAB_ERROR:
        slabs, slab_error, slab_usage = search.cover_with_slabs()
        if slab_usage <= budget.limit and (usage > budget.limit or error > MAX_SLAB_RATIO * slab_error):
            return [slabs] * builder.settings.levels, slab_error
        usage = min(usage, slab_usage)
    if math.isinf(usage):
        raise SettingsError(
            f'"{name}" needs a texture of more than {budget.max_texels / 1e6:.1f} million texels even at the largest error of '
            f"{MAX_ERROR:.0%}; use a larger Texel Size.",
            ("texel_size",),
        )
    if usage > budget.limit:
        field_name, label = budget.setting
        raise SettingsError(
            f'"{name}" needs at least {budget.format_amount(usage)}, at the largest error of {MAX_ERROR:.0%}, but {label} is '
            f"{budget.limit:g}; increase it.",
            (field_name,),
        )
    complete = []
    for index, (group, attempt) in enumerate(allocation):
        steps = search.build_all_levels(group, attempt)
        start, stop = (1.0 - COARSE_LEVELS_PROGRESS + COARSE_LEVELS_PROGRESS * i / len(allocation) for i in (index, index + 1))
        coverings = yield from subprogress(steps, start, stop)
        complete.append((group, replace(attempt, coverings=coverings)))
    return search.combine(complete), max_relative_error(complete)


Allocation = list[tuple[BudgetGroup, Attempt]]  # The groups contain every primitive once.


def max_relative_error(allocation: Allocation) -> float:
    """Return the relative error of the finest level that the groups form together."""
    return max(attempt.relative_error for _, attempt in allocation)


@dataclass(frozen=True)
class _BudgetSearch:
    """The complete input of a search, and the builds and measurements that it makes."""

    primitives: Primitives
    components: Components
    builder: LevelBuilder
    budget: Budget

    @property
    def measured_count(self) -> int:
        """How many levels count for the budget."""
        return self.budget.count_measured_levels(self.builder.settings.levels)

    def allocate(self) -> Steps[Allocation]:
        """Find one attempt per group that together meet the budget.

        If a group exceeds its fraction, returns a single error for all primitives, even if that exceeds the budget.
        """
        allocation: Allocation = []
        limit = self.budget.limit
        groups = split_into_groups(self.primitives, self.components, self.builder.settings.loose_fraction)
        for index, group in enumerate(groups):
            if allocation:
                group = replace(group, fraction=1.0 - self.measure(allocation) / limit)
            steps = self.solve_alone(group, group.fraction * limit)
            attempt = yield from subprogress(steps, GROUP_PROGRESS * index, GROUP_PROGRESS * (index + 1))
            if attempt.usage > group.fraction * limit:
                return (yield from subprogress(self.solve_with_one_error(), GROUP_PROGRESS * (index + 1), 1.0))
            allocation.append((group, attempt))
        if len(groups) > 1 and not MIN_FRACTION * limit <= self.measure(allocation) <= limit:
            coarser = max((0, 1), key=lambda index: allocation[index][1].relative_error)
            steps = self.solve_remaining(allocation[1 - coarser], allocation[coarser])
            allocation[coarser] = allocation[coarser][0], (yield from subprogress(steps, 2.0 * GROUP_PROGRESS, 1.0))
        return allocation

    def solve_with_one_error(self) -> Steps[Allocation]:
        """Find one error for all primitives."""
        group = BudgetGroup(np.arange(len(self.primitives)), self.primitives, self.components, 1.0)
        return [(group, (yield from self.solve_alone(group, self.budget.limit)))]

    def solve_alone(self, group: BudgetGroup, limit: float) -> Steps[Attempt]:
        """Find the attempt at `group` that meets `limit`, independently of other groups."""

        def build(error: float) -> Steps[Attempt]:
            coverings = yield from self.build_finest(group, error)
            return Attempt(error, self.measure_coverings(group.primitives, group.components, coverings, error), coverings)

        return (yield from search_error(build, limit, self.guess_error(group, limit), self.budget.exponent))

    def solve_remaining(self, fixed: tuple[BudgetGroup, Attempt], initial: tuple[BudgetGroup, Attempt]) -> Steps[Attempt]:
        """Find an attempt for the group of `initial` that meets the whole limit together with `fixed`. Its usage is that of both."""
        group, first = initial

        def measure_both(error: float, coverings: list[Covering]) -> Attempt:
            attempt = Attempt(error, 0.0, coverings)
            return replace(attempt, usage=self.measure([fixed, (group, attempt)]))

        def build(error: float) -> Steps[Attempt]:
            return measure_both(error, (yield from self.build_finest(group, error)))

        known = [measure_both(first.relative_error, first.coverings)]
        limit, exponent = self.budget.limit, self.budget.exponent
        return (yield from search_error(build, limit, first.relative_error, exponent, known, MAX_REMAINING_BUILDS))

    def guess_error(self, group: BudgetGroup, limit: float) -> float:
        """Return the relative error that meets `limit` according to the estimate, or that of the settings if none does."""
        if limit <= 0.0:
            return MAX_ERROR
        side = self.builder.longest_side
        settings = self.budget.replace_in_settings(self.builder.settings, limit)
        levels = estimate_levels(sample_primitives(group.primitives, side), settings)
        counts = {"quads": levels[0].quads, "triangles": levels[0].triangles}
        expected = counts.get(self.budget.setting[0], texture_megabytes(sum(level.texels for level in levels)))
        return levels[0].error / side if MIN_FRACTION * limit <= expected <= limit else self.builder.settings.error

    def build_finest(self, group: BudgetGroup, error: float) -> Steps[list[Covering]]:
        """Build the coverings of `group` that count for the budget."""
        area = self.reference_area(group)
        return self.builder.build_coverings(group.primitives, group.components, error, self.measured_count, reference_area=area)

    def build_all_levels(self, group: BudgetGroup, attempt: Attempt) -> Steps[list[Covering]]:
        """Build the coverings above those of `attempt` and return all."""
        count, finest = self.builder.settings.levels, attempt.coverings
        if len(finest) == count:
            return finest
        area = self.reference_area(group)
        steps = self.builder.build_coverings(group.primitives, group.components, attempt.relative_error, count, finest, area)
        return (yield from steps)

    def reference_area(self, group: BudgetGroup) -> float:
        """Return the area against which a quad of `group` is weighed: its fraction of the total, so that quads cost the same in both."""
        return max(group.fraction, MIN_AREA_FRACTION) * float(self.primitives.areas.sum())

    def cover_with_slabs(self) -> tuple[Covering, float, float]:
        """Return the finest covering with slabs that meets the budget, or the coarsest one, its relative error and its usage."""
        count = max(int(self.budget.limit if self.budget.quads else MAX_SLAB_QUADS), MIN_SLABS)
        while True:
            covering, error = cover_with_slabs(self.primitives, self.builder.longest_side, count)
            usage = self.measure_coverings(self.primitives, self.components, [covering] * self.measured_count, error)
            if usage <= self.budget.limit or count <= MIN_SLABS:
                return covering, error, usage
            count = max(min(count - 1, int(count * self.budget.limit / usage)), MIN_SLABS)

    def measure(self, allocation: Allocation) -> float:
        """Return the usage of the groups in `allocation` together."""
        if len(allocation) == 1:
            return allocation[0][1].usage
        return self.measure_coverings(self.primitives, self.components, self.combine(allocation), max_relative_error(allocation))

    def measure_coverings(self, primitives: Primitives, components: Components, coverings: list[Covering], error: float) -> float:
        """Return the usage of the levels of `coverings`; infinite if no texture is large enough, or one is too large for the budget."""
        try:
            levels = self.builder.build_levels(primitives, components, coverings, error)
            if not self.builder.settings.keeps_all_levels:
                levels, _ = keep_lighter_levels(levels, self.builder.longest_side)
        except SettingsError:
            return math.inf
        is_too_large = any(math.prod(level.atlas.size) > self.budget.max_texels for level in levels)
        return math.inf if is_too_large else self.budget.measure_usage(levels)

    def combine(self, allocation: Allocation) -> list[Covering]:
        """Return the union of the groups' coverings per level, in the numbering of all primitives."""
        levels = zip(*(attempt.coverings for _, attempt in allocation), strict=True)
        indices = [group.indices for group, _ in allocation]
        return [merge_coverings(list(zip(indices, coverings, strict=True)), len(self.primitives)) for coverings in levels]
