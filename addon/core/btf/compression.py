"""From finished views of a level to what its material decodes: lobes, hues, and factors of colours and silhouettes."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..parallel import mapped
from ..progress import Progress, Steps, scaled
from .alternation import by_light
from .broad_suns import BroadSuns
from .codecs import compressed_colours
from .dome import under_dome
from .factors import Factors, factorise_columns
from .glow import mean_glow
from .lobes import Lobes, Surface, fit_lobes
from .photographs import broad_lights
from .quality import Fit, quality
from .readings import Colours, Domes, silhouettes
from .refine import refined, seen, shown, texel_colours
from .rests import write_rests
from .settings import BtfSettings
from .shadows import Shadows, find_shadows
from .shards import ShardStore
from .texels import PARTS, Texels
from .tints import tints
from .training import TrainingView

LEAST_FACING = 0.03  # cosine: what a texel counts at least from a view that sees its quad from the edge
READ, TINTED, SHADOWED, FITTED, TAKEN, COLOURED, COVERED = 0.02, 0.05, 0.2, 0.6, 0.75, 0.95, 0.97  # of the bar of `compress`
LIT = 0.3  # of the bar of `refine`


@dataclass(frozen=True)
class Compressed:
    """A level's textures: lobes, None where its plain maps say nothing of the surface; hues (N, 3); factors of colours and of alpha; what
    shines by itself (N, 3), None where nothing does."""

    lobes: Lobes | None
    hues: np.ndarray
    colour: Factors
    alpha: Factors
    glow: np.ndarray | None = None

    @property
    def bytes(self) -> int:
        """What they take as half floats."""
        of_maps = 2 * (self.hues.size + (0 if self.glow is None else self.glow.size))
        return of_maps + self.colour.bytes + self.alpha.bytes + (0 if self.lobes is None else self.lobes.bytes)


class Compression:
    """Compresses what `store` holds of all views of a level.

    plain: the coverage (N,) of its texels in the plain maps, and surface: their normals and roughness, None where there are none.
    """

    def __init__(self, store: ShardStore, texels: Texels, plain: np.ndarray, surface: Surface | None, settings: BtfSettings) -> None:
        self._store, self._texels, self._plain, self._surface, self._settings = store, texels, plain, surface, settings
        self._views, self._lights = settings.view_grid, settings.light_grid
        self._suns = BroadSuns(self._lights.directions, settings.sun_size)
        self._weights = np.zeros((len(self._views), len(texels)), np.float32)
        self._light_weights = np.zeros(len(self._lights) + 1)
        self._captured = [Colours(store, view) for view in range(len(self._views))]

    def compress(self) -> Steps[Compressed]:
        """Lobes, hues and factors."""
        count, settings, angles = len(self._texels), self._settings, self._views.solid_angles
        yield from scaled(self._weigh(), 0.0, READ)
        hues = yield from scaled(tints(self._captured, count, angles, self._light_weights), READ, TINTED)
        shadows = yield from scaled(self._shadows(), TINTED, SHADOWED)
        lobes = yield from scaled(self._lobes(shadows), SHADOWED, FITTED)
        try:
            rests = yield from scaled(write_rests(self._store, hues, lobes, self._views, self._suns), FITTED, TAKEN)
            steps = compressed_colours(rests, count, self._weights, self._column_weights, settings)
            colour = yield from scaled(steps, TAKEN, COLOURED)
        finally:
            self._store.remove_rests()
        covered = yield from scaled(silhouettes(self._store, self._plain, angles), COLOURED, COVERED)
        alpha = yield from scaled(factorise_columns(covered, settings.alpha_components, settings.seed), COVERED, 1.0)
        glow = mean_glow((self._store.glow(view) for view in range(len(self._views))), self._weights)
        return Compressed(lobes, hues, colour, alpha, glow)

    def refine(self, made: Compressed, photographed: list[TrainingView]) -> Steps[Compressed]:
        """`made` with silhouettes refined against the photographs of all views. Raises FileError when the work folder's disk is full."""
        try:
            yield from scaled(self._keep_looks(made, photographed), 0.0, LIT)
            alpha = yield from scaled(refined(photographed, made.alpha, self._plain, self._views.solid_angles), LIT, 1.0)
        finally:
            self._store.remove_looks()
        return replace(made, alpha=alpha)

    def measure(self, made: Compressed) -> Steps[list[Fit]]:
        """How near the colours of `made` come to what was captured, by the number of components."""

        more = None if made.lobes is None else partial(self._of_lobes, made.lobes)
        return (yield from quality(self._captured, made.colour, made.hues, self._weights, self._column_weights, more))

    def captured(self, view: int) -> tuple[np.ndarray, np.ndarray]:
        """The texels (M,) that a view saw, and their colours (M, L + 1, 3) float32 under every sun and last the dome."""
        visible, values = self._captured[view].read()
        return visible, by_light(values)

    def shown(self, made: Compressed, view: int, rows: np.ndarray) -> np.ndarray:
        """What `made` shows of the texels `rows` (M,) instead; both before the shader cuts what is below 0."""
        colours = by_light(made.colour.spread(rows) @ made.colour.basis[view]) * made.hues[rows, None]
        return colours if made.lobes is None else colours + by_light(self._of_lobes(made.lobes, view, rows))

    def _of_lobes(self, lobes: Lobes, view: int, rows: np.ndarray) -> np.ndarray:
        return lobes.of_grid(self._views.directions[view], self._suns, rows).reshape(len(rows), -1)

    def _keep_looks(self, made: Compressed, photographed: list[TrainingView]) -> Steps[None]:
        """Have all views keep what rays meet and its colours, as far as that matters."""
        lights = broad_lights(self._lights)

        def keep(number: int) -> None:
            alpha = self._plain + made.alpha.applied(made.alpha.basis[number])[:, 0]
            fragments = seen(photographed[number].fragments(), alpha)
            colours = texel_colours(made.colour, number, made.hues, lights)
            if made.lobes is not None:
                rows = np.unique(fragments.texels)
                colours[rows] += made.lobes.under(lights, self._views.directions[number], self._suns, rows)
            photographed[number].keep(fragments, shown(fragments, colours))

        for number, _ in enumerate(mapped(keep, range(len(self._views)))):
            yield Progress(number / len(self._views), "Lighting the lobes")

    def _weigh(self) -> Steps[None]:
        """Find what each texel counts from each view, as much as it fills of the picture there, and what each light does.

        The dome counts so much that its colours have the energy of all others: it is ten times as bright as a sun, and so would take all
        components for itself where it is weighted like one.
        """
        facing = np.maximum(self._texels.facing(self._views.directions), LEAST_FACING)
        angles = self._views.solid_angles

        def of_view(view: int) -> np.ndarray:
            visible, parts, radiance = self._store.read(view, "visible", "parts", "radiance")
            counting = (angles[view] * facing[view, visible] ** 2 * parts / PARTS**2).astype(np.float32)
            self._weights[view, visible] = counting
            return np.square(radiance.astype(np.float32)).sum(axis=2) @ counting

        energy = np.zeros(len(self._lights) + 1)
        for view, found in enumerate(mapped(of_view, range(len(self._views)))):
            yield Progress(view / len(self._views), "Reading what was seen")
            energy += found
        of_suns = self._lights.solid_angles @ energy[:-1]
        self._light_weights = np.append(self._lights.solid_angles, of_suns / energy[-1] if energy[-1] > 0.0 else 1.0)

    @property
    def _column_weights(self) -> np.ndarray:
        return np.repeat(self._light_weights, 3)

    def _shadows(self) -> Steps[Shadows | None]:
        """The shadows, of which the suns are told."""
        settings, grid = self._settings, self._settings.shadow_grid
        if self._surface is None or grid is None:
            return None
        lit = self._store.lit(len(self._views))
        shadows = yield from find_shadows(lit, grid, self._surface.normals, settings.shadow_components, settings.seed)
        self._suns = self._suns.behind(shadows.reached_by(self._suns), shadows.openness(self._surface.normals))
        return shadows

    def _lobes(self, shadows: Shadows | None) -> Steps[Lobes | None]:
        if self._surface is None:
            return None
        quads = self._texels.quads
        steps = fit_lobes(self._captured, self._surface, quads, self._views, self._suns, self._weights, self._light_weights)
        found = yield from scaled(steps, 0.0, 0.8)
        domes = [Domes(self._store, view) for view in range(len(self._views))]
        lobes = replace(found, shadows=shadows, openness=self._suns.openness)
        return (yield from scaled(under_dome(domes, lobes, self._views, self._weights), 0.8, 1.0))
