"""A number of quads or megabytes instead of an error: the error is searched that meets it.

Loose parts and connected surfaces, leaves and trunk, each get a part of the budget and an error of their own; a kind that cannot use up its
part leaves the rest to the other, and where one cannot do with its part both take the same error. A level is the union of both and keeps
the larger of the two errors, since it is from there on that nobody can tell it from the original; all its texels have the size that this
error asks for.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import SettingsError
from ..progress import Steps, scaled
from .cloud import Level
from .estimate import BYTES_PER_TEXEL, estimate, sample_of
from .levels import LevelBuilder
from .patches import Covering, union
from .primitives import Primitives
from .search import ENOUGH, LARGEST, Attempt, search
from .settings import BillboardSettings
from .surfaces import Surfaces

BUILDS_FOR_THE_REST = 4  # of the kind that gets what is left over
LEAST_WEIGHT = 0.05  # of the whole area
QUADS_POWER = 1.2  # of one over the error: how the number of quads grows, for heads and trees
TEXTURE_POWER = 2.0  # texels have two sides


@dataclass(frozen=True)
class Budget:
    """Either quads at the finest level or megabytes of texture of all levels; the other is 0."""

    quads: int
    megabytes: float

    @property
    def limit(self) -> float:
        """The largest amount, in the unit of `used`."""
        return self.quads or self.megabytes

    @property
    def power(self) -> float:
        """What is used falls about as the error to the power of -`power`."""
        return QUADS_POWER if self.quads else TEXTURE_POWER

    def measured_levels(self, levels: int) -> int:
        """How many of the `levels` of a cloud count, from the finest on."""
        return 1 if self.quads else levels

    def used(self, levels: Sequence[Level]) -> float:
        """What `levels` take: quads of the first, or megabytes of all as Blender will hold them, gutters and all maps."""
        return len(levels[0].quads) if self.quads else megabytes(sum(math.prod(level.atlas.size) for level in levels))

    def instead_of_error(self, settings: BillboardSettings, limit: float) -> BillboardSettings:
        """`settings` that ask for `limit`, a positive amount, of the same thing."""
        return replace(settings, quads=max(1, int(limit))) if self.quads else replace(settings, texture_mb=limit)

    def described(self, amount: float) -> str:
        """`amount` for people, never less than it is."""
        return f"{math.ceil(amount)} quads" if self.quads else f"{math.ceil(amount * 1000.0) / 1000.0:g} MB of texture"


def budget_of(settings: BillboardSettings) -> Budget | None:
    """The budget that `settings` ask for, or None where they take an error.

    Raises:
        SettingsError: when they ask for both quads and megabytes.
    """
    if settings.quads and settings.texture_mb:
        raise SettingsError(f"--quads {settings.quads} and --texture-mb {settings.texture_mb:g} are two budgets; leave one of them 0.")
    return Budget(settings.quads, settings.texture_mb) if settings.quads or settings.texture_mb else None


def megabytes(texels: int) -> float:
    """What all maps of a texture with so many `texels` take."""
    return texels * BYTES_PER_TEXEL / 1e6


@dataclass(frozen=True)
class Kind:
    """Primitives that share one error and one part of the budget.

    index (K,): their numbers among all, in which the other fields are counted. part: of the budget, 0..1.
    """

    index: np.ndarray
    primitives: Primitives
    surfaces: Surfaces
    part: float


def kinds_of(primitives: Primitives, surfaces: Surfaces, loose_part: float) -> list[Kind]:
    """Loose parts and connected surfaces, or the one kind that there is; first the one with fewer primitives for its part of the budget,
    which is the likelier to leave some of it."""
    loose = surfaces.loose
    if loose.all() or not loose.any():
        return [Kind(np.arange(len(primitives)), primitives, surfaces, 1.0)]
    members = ((np.flatnonzero(loose), loose_part), (np.flatnonzero(~loose), 1.0 - loose_part))
    kinds = [Kind(index, primitives.subset(index), surfaces.subset(index), part) for index, part in members]
    return sorted(kinds, key=lambda kind: len(kind.index) / max(kind.part, 1e-9))


def within_budget(
    primitives: Primitives, surfaces: Surfaces, builder: LevelBuilder, budget: Budget, name: str
) -> Steps[tuple[list[Covering], float]]:
    """The coverings of all levels that take no more than `budget` and come near to it, and the larger error of the finest one's kinds, over
    the longest side.

    Raises:
        SettingsError: when even the largest error takes more; `name` says of what.
    """
    task = _Task(primitives, surfaces, builder, budget)
    found = yield from scaled(task.shared_out(), 0.0, 0.8)
    used = task.used(found)
    if used > budget.limit:
        raise SettingsError(
            f'"{name}" takes at least {budget.described(used)}, at the largest error of {LARGEST:.0%}, and '
            f"{budget.described(budget.limit)} were asked for; ask for more."
        )
    whole = []
    for number, (kind, attempt) in enumerate(found):
        steps = task.all_levels(kind, attempt)
        coverings = yield from scaled(steps, 0.8 + 0.2 * number / len(found), 0.8 + 0.2 * (number + 1) / len(found))
        whole.append((kind, replace(attempt, coverings=coverings)))
    return task.together(whole), error_of(whole)


Found = list[tuple[Kind, Attempt]]  # every primitive belongs to one of the kinds


def error_of(found: Found) -> float:
    """The error of the finest level that the kinds make together, over the longest side."""
    return max(attempt.share for _, attempt in found)


@dataclass(frozen=True)
class _Task:
    """What is to fit into the budget, and what it takes to try an error for a kind of it."""

    primitives: Primitives
    surfaces: Surfaces
    builder: LevelBuilder
    budget: Budget

    def shared_out(self) -> Steps[Found]:
        """An attempt a kind that together meet the budget. Where a kind cannot do with its part all take one error, if over too."""
        found: Found = []
        limit = self.budget.limit
        kinds = kinds_of(self.primitives, self.surfaces, self.builder.settings.loose_part_share)
        for number, kind in enumerate(kinds):
            if found:
                kind = replace(kind, part=1.0 - self.used(found) / limit)
            attempt = yield from scaled(self.alone(kind, kind.part * limit), 0.3 * number, 0.3 * (number + 1))
            if attempt.used > kind.part * limit:
                return (yield from scaled(self.same_error(), 0.3 * (number + 1), 1.0))
            found.append((kind, attempt))
        if len(kinds) > 1 and not ENOUGH * limit <= self.used(found) <= limit:
            coarser = max((0, 1), key=lambda number: found[number][1].share)
            found[coarser] = found[coarser][0], (yield from scaled(self.beside(found[1 - coarser], found[coarser]), 0.6, 1.0))
        return found

    def same_error(self) -> Steps[Found]:
        """One error for everything."""
        everything = Kind(np.arange(len(self.primitives)), self.primitives, self.surfaces, 1.0)
        return [(everything, (yield from self.alone(everything, self.budget.limit)))]

    def alone(self, kind: Kind, limit: float) -> Steps[Attempt]:
        """The attempt at `kind` by itself that meets `limit`."""

        def build(share: float) -> Steps[Attempt]:
            coverings = yield from self.finest(kind, share)
            return Attempt(share, self.measured(kind.primitives, kind.surfaces, coverings, share), coverings)

        return (yield from search(build, limit, self.guess(kind, limit), self.budget.power))

    def beside(self, standing: tuple[Kind, Attempt], given: tuple[Kind, Attempt]) -> Steps[Attempt]:
        """An attempt instead of the `given` one that meets the whole limit together with the `standing` one; used is what both take."""
        kind, first = given

        def joined(share: float, coverings: list[Covering]) -> Attempt:
            attempt = Attempt(share, 0.0, coverings)
            return replace(attempt, used=self.used([standing, (kind, attempt)]))

        def build(share: float) -> Steps[Attempt]:
            return joined(share, (yield from self.finest(kind, share)))

        known = [joined(first.share, first.coverings)]
        return (yield from search(build, self.budget.limit, first.share, self.budget.power, known, BUILDS_FOR_THE_REST))

    def guess(self, kind: Kind, limit: float) -> float:
        """The error that the estimate expects to meet `limit`; the one of the settings where it thinks that none does."""
        if limit <= 0.0:
            return LARGEST
        asked = self.budget.instead_of_error(self.builder.settings, limit)
        levels = estimate(sample_of(kind.primitives, self.builder.side), asked)
        expected = levels[0].quads if self.budget.quads else megabytes(sum(level.texels for level in levels))
        return levels[0].error / self.builder.side if ENOUGH * limit <= expected <= limit else self.builder.settings.error

    def finest(self, kind: Kind, share: float) -> Steps[list[Covering]]:
        """The coverings of `kind` that count for the budget."""
        count = self.budget.measured_levels(self.builder.settings.levels)
        return self.builder.coverings(kind.primitives, kind.surfaces, share, count, area=self.weight(kind))

    def all_levels(self, kind: Kind, attempt: Attempt) -> Steps[list[Covering]]:
        """The coverings of `attempt` and of the levels above them."""
        count, finest = self.builder.settings.levels, attempt.coverings
        if len(finest) == count:
            return finest
        return (yield from self.builder.coverings(kind.primitives, kind.surfaces, attempt.share, count, finest, self.weight(kind)))

    def weight(self, kind: Kind) -> float:
        """What a quad of `kind` is weighed against: its part of the whole area, so that a quad is worth the same on all kinds."""
        return max(kind.part, LEAST_WEIGHT) * float(self.primitives.areas.sum())

    def used(self, found: Found) -> float:
        """What the kinds in `found` take together."""
        if len(found) == 1:
            return found[0][1].used
        return self.measured(self.primitives, self.surfaces, self.together(found), error_of(found))

    def measured(self, primitives: Primitives, surfaces: Surfaces, coverings: list[Covering], share: float) -> float:
        """What the levels that `coverings` make take of the budget; infinite where no texture is large enough."""
        try:
            return self.budget.used(self.builder.levels(primitives, surfaces, coverings, share))
        except SettingsError:
            return math.inf

    def together(self, found: Found) -> list[Covering]:
        """The union, level by level, of the coverings in `found`, in the numbering of all primitives."""
        levels = zip(*(attempt.coverings for _, attempt in found), strict=True)
        indices = [kind.index for kind, _ in found]
        return [union(list(zip(indices, coverings, strict=True)), len(self.primitives)) for coverings in levels]
