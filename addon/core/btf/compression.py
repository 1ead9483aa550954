"""From finished views of a level to what its material decodes: lobes, hues, and factors of colours and silhouettes."""

from dataclasses import dataclass, replace

import numpy as np

from ..progress import Progress, Steps, scaled
from .broad_suns import BroadSuns
from .codecs import compressed_colours
from .dome import under_dome
from .factors import Factors, factorise
from .glow import mean_glow
from .lobes import Lobes, Surface, fit_lobes
from .photographs import broad_lights
from .quality import Fit, quality
from .refine import Training, refined, seen_texels
from .rests import write_rests
from .settings import BtfSettings
from .shadows import Shadows, find_shadows
from .shards import Colours, ShardStore, Silhouettes
from .texels import Texels
from .tints import tints

DOME_WEIGHT = np.pi  # as much as a quarter of all suns: a sky is dimmer than a sun, but alone where that does not reach
LEAST_FACING = 0.03  # cosine: what a texel counts at least from a view that sees its quad from the edge
TINTED, SHADOWED, FITTED, TAKEN, COLOURED = 0.1, 0.2, 0.5, 0.6, 0.9  # of the bar of `compress`
LIT = 0.1  # of the bar of `refine`


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
        self._light_weights = np.append(self._lights.solid_angles, DOME_WEIGHT)
        self._weights = self._views.solid_angles[:, None] * np.maximum(texels.facing(self._views.directions), LEAST_FACING) ** 2
        self._captured = [Colours(store, view) for view in range(len(self._views))]

    def compress(self) -> Steps[Compressed]:
        """Lobes, hues and factors."""
        count, settings, angles = len(self._texels), self._settings, self._views.solid_angles
        silhouettes = [Silhouettes(self._store, view, self._plain) for view in range(len(self._views))]
        hues = yield from scaled(tints(self._captured, count, angles, self._light_weights), 0.0, TINTED)
        shadows = yield from scaled(self._shadows(), TINTED, SHADOWED)
        lobes = yield from scaled(self._lobes(shadows), SHADOWED, FITTED)
        try:
            rests = yield from scaled(write_rests(self._store, hues, lobes, self._views, self._suns), FITTED, TAKEN)
            steps = compressed_colours(rests, count, self._weights, self._column_weights, settings)
            colour = yield from scaled(steps, TAKEN, COLOURED)
        finally:
            self._store.remove_rests()
        steps = factorise(silhouettes, count, settings.alpha_components, angles, np.ones(1), settings.seed)
        alpha = yield from scaled(steps, COLOURED, 1.0)
        glow = mean_glow((self._store.glow(view) for view in range(len(self._views))), self._weights)
        return Compressed(lobes, hues, colour, alpha, glow)

    def refine(self, made: Compressed, photographed: list[Training]) -> Steps[Compressed]:
        """`made` with silhouettes refined against the photographs of all views."""
        lights, lit = broad_lights(self._lights), None
        if made.lobes is not None:
            lit = []
            for number, view in enumerate(self._views.directions):
                yield Progress(LIT * number / len(self._views), "Lighting the lobes")
                coverage = self._plain + made.alpha.applied(made.alpha.basis[number])[:, 0]
                wanted = seen_texels(photographed[number].fragments(), coverage)
                lit.append(made.lobes.under(lights, view, self._suns, wanted))
        steps = refined(photographed, made.colour, made.hues, made.alpha, self._plain, lights, self._views.solid_angles, lit)
        alpha = yield from scaled(steps, LIT, 1.0)
        return replace(made, alpha=alpha)

    def measure(self, made: Compressed) -> Steps[list[Fit]]:
        """How near the colours of `made` come to what was captured, by the number of components."""

        def of_lobes(view: int, rows: np.ndarray) -> np.ndarray:
            return made.lobes.of_grid(self._views.directions[view], self._suns, rows).reshape(len(rows), -1)

        more = None if made.lobes is None else of_lobes
        return (yield from quality(self._captured, made.colour, made.hues, self._weights, self._column_weights, more))

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
        lobes = replace(found, shadows=shadows, openness=self._suns.openness)
        return (yield from scaled(under_dome(self._captured, lobes, self._views, self._weights), 0.8, 1.0))
