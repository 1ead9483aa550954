"""Compression of the finished views of a level into textures: lobes, chromaticity, and factors of residual colors and of alpha."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..billboards.texels import Texels
from ..jobs.chunks import map_ordered
from ..jobs.progress import Progress, Steps, subprogress
from .capture.observations import SUBSAMPLES, low_order_lights
from .capture.shards import ShardStore
from .capture.view_data import DomeView, RadianceView, read_silhouettes
from .factorization.als import ViewMatrix, split_lights
from .factorization.factors import ComponentError, Factors, error_by_components, factorize, factorize_scalar
from .factorization.lpca import factorize_lpca
from .refinement.refine import compute_texel_colors
from .refinement.training import StoredTrainingView, refine_stored_views
from .reflectance.disc_lights import DiscLights
from .reflectance.lobe_fit import CapturedRadiance, fit_dome, fit_lobes
from .reflectance.lobes import Lobes, TexelSurface
from .reflectance.mean_colors import compute_chromaticity, mean_emission
from .reflectance.residuals import residual_files, write_residuals
from .reflectance.shadows import Shadows, compute_shadows
from .settings import BtfSettings

MIN_COSINE = 0.03  # Minimum weight of a texel in a view that sees its quad edge-on.
# Ends of the stages in the progress bar of `compress`.
WEIGHTS_END, CHROMATICITY_END, SHADOWS_END, LOBES_END, RESIDUALS_END, COLOR_END, SILHOUETTES_END = 0.02, 0.05, 0.2, 0.6, 0.75, 0.95, 0.97


@dataclass(frozen=True)
class CompressedTextures:
    """Compressed textures of a level with N texels.

    Attributes:
        lobes: None when the PBR maps contain no surface.
        chromaticity: (N, 3).
        color: Factors of the residual colors.
        alpha: Factors of the coverage.
        emission: (N, 3); None without emission.
    """

    lobes: Lobes | None
    chromaticity: np.ndarray
    color: Factors
    alpha: Factors
    emission: np.ndarray | None = None

    @property
    def nbytes(self) -> int:
        """Size as half floats."""
        map_bytes = 2 * (self.chromaticity.size + (0 if self.emission is None else self.emission.size))
        return map_bytes + self.color.nbytes + self.alpha.nbytes + (0 if self.lobes is None else self.lobes.nbytes)


class LevelCompressor:
    """Compresses the finished views of a level in `store`.

    pbr_alpha (N,): coverage of the texels in the PBR maps. surface: their normals and roughness; None without such maps.
    """

    def __init__(
        self, store: ShardStore, texels: Texels, pbr_alpha: np.ndarray, surface: TexelSurface | None, settings: BtfSettings
    ) -> None:
        self._store, self._texels, self._pbr_alpha, self._surface, self._settings = store, texels, pbr_alpha, surface, settings
        self._views, self._lights = settings.view_grid, settings.light_grid
        self._suns = DiscLights(self._lights.directions, settings.sun_solid_angle)
        self._weights = np.zeros((len(self._views), len(texels)), np.float32)
        self._light_weights = np.zeros(len(self._lights) + 1)
        self._captured = [RadianceView(store, view) for view in range(len(self._views))]

    def compress(self) -> Steps[CompressedTextures]:
        """Compute lobes, chromaticity, emission, and the factors of residual colors and of alpha."""
        count, settings, solid_angles = len(self._texels), self._settings, self._views.solid_angles
        yield from subprogress(self._compute_weights(), 0.0, WEIGHTS_END)
        steps = compute_chromaticity(self._captured, count, solid_angles, self._light_weights)
        chromaticity = yield from subprogress(steps, WEIGHTS_END, CHROMATICITY_END)
        shadows = yield from subprogress(self._compute_shadows(), CHROMATICITY_END, SHADOWS_END)
        lobes = yield from subprogress(self._fit_lobes(shadows), SHADOWS_END, LOBES_END)
        try:
            steps = write_residuals(self._store, chromaticity, lobes, self._views, self._suns)
            residuals = yield from subprogress(steps, LOBES_END, RESIDUALS_END)
            matrix = ViewMatrix(residuals, count, self._weights, self._column_weights)
            if settings.codec == "lpca":
                steps = factorize_lpca(matrix, settings.clusters, settings.cluster_components, settings.seed)
            else:
                steps = factorize(matrix, settings.components, settings.seed)
            color = yield from subprogress(steps, RESIDUALS_END, COLOR_END)
        finally:
            residual_files(self._store).remove_all()
        silhouettes = yield from subprogress(read_silhouettes(self._store, self._pbr_alpha, solid_angles), COLOR_END, SILHOUETTES_END)
        alpha = yield from subprogress(factorize_scalar(silhouettes, settings.alpha_components, settings.seed), SILHOUETTES_END, 1.0)
        emission = mean_emission((self._store.read_emission(view) for view in range(len(self._views))), self._weights)
        return CompressedTextures(lobes, chromaticity, color, alpha, emission)

    def refine(self, textures: CompressedTextures, training_views: list[StoredTrainingView]) -> Steps[CompressedTextures]:
        """Return `textures` with alpha refined against the reference images of all views. Raises FileError."""
        lights = low_order_lights(self._lights)

        def texel_colors(view: int, rows: np.ndarray) -> np.ndarray:
            colors = compute_texel_colors(textures.color, view, textures.chromaticity, lights)
            if textures.lobes is not None:
                colors[rows] += textures.lobes.radiance_under_lights(lights, self._views.directions[view], self._suns, rows)
            return colors

        solid_angles = self._views.solid_angles
        alpha = yield from refine_stored_views(training_views, textures.alpha, self._pbr_alpha, solid_angles, texel_colors)
        return replace(textures, alpha=alpha)

    def measure_error(self, textures: CompressedTextures) -> Steps[list[ComponentError]]:
        """Measure the error of the colors of `textures` against the captured colors, by number of components."""
        offset = None if textures.lobes is None else partial(self._lobe_radiance, textures.lobes)
        matrix = ViewMatrix(self._captured, len(self._texels), self._weights, self._column_weights)
        return (yield from error_by_components(matrix, textures.color, textures.chromaticity, offset))

    def captured_colors(self, view: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the visible texels (M,) of a view and their captured colors (M, L + 1, 3) float32 under every sun and, last, the dome."""
        visible, values = self._captured[view].read()
        return visible, split_lights(values)

    def decoded_colors(self, textures: CompressedTextures, view: int, rows: np.ndarray) -> np.ndarray:
        """Return the colors (M, L + 1, 3) of the texels `rows` (M,) decoded from `textures`, not clamped at 0."""
        colors = split_lights(textures.color.dense_weights(rows) @ textures.color.basis[view]) * textures.chromaticity[rows, None]
        return colors if textures.lobes is None else colors + split_lights(self._lobe_radiance(textures.lobes, view, rows))

    def _lobe_radiance(self, lobes: Lobes, view: int, rows: np.ndarray) -> np.ndarray:
        return lobes.radiance_on_grid(self._views.directions[view], self._suns, rows).reshape(len(rows), -1)

    def _compute_weights(self) -> Steps[None]:
        """Compute the weight of each texel in each view, from its projected visible area, and the weight of each light.

        The dome's weight gives its colors the energy of all others together. The dome is ten times as bright as a sun; with a sun's weight
        it would use up all components.
        """
        cosines = np.maximum(self._texels.view_cosines(self._views.directions), MIN_COSINE)
        solid_angles = self._views.solid_angles

        def weigh_view(view: int) -> np.ndarray:
            visible, counts, radiance = self._store.read(view, "visible", "subsample_counts", "radiance")
            weights = (solid_angles[view] * cosines[view, visible] ** 2 * counts / SUBSAMPLES**2).astype(np.float32)
            self._weights[view, visible] = weights
            return np.square(radiance.astype(np.float32)).sum(axis=2) @ weights

        energy = np.zeros(len(self._lights) + 1)
        for view, view_energy in enumerate(map_ordered(weigh_view, range(len(self._views)))):
            yield Progress(view / len(self._views), "Reading views")
            energy += view_energy
        sun_energy = self._lights.solid_angles @ energy[:-1]
        self._light_weights = np.append(self._lights.solid_angles, sun_energy / energy[-1] if energy[-1] > 0.0 else 1.0)

    @property
    def _column_weights(self) -> np.ndarray:
        return np.repeat(self._light_weights, 3)

    def _compute_shadows(self) -> Steps[Shadows | None]:
        """Compute the shadows and set the visibility of the suns."""
        settings, grid = self._settings, self._settings.shadow_grid
        if self._surface is None or grid is None:
            return None
        visibility = self._store.read_visibility(len(self._views))
        shadows = yield from compute_shadows(visibility, grid, self._surface.normals, settings.shadow_components, settings.seed)
        self._suns = self._suns.with_visibility(shadows.mean_visibility(self._suns), shadows.sky_visibility(self._surface.normals))
        return shadows

    def _fit_lobes(self, shadows: Shadows | None) -> Steps[Lobes | None]:
        if self._surface is None:
            return None
        captured = CapturedRadiance(self._captured, self._views, self._suns, self._weights, self._light_weights)
        lobes = yield from subprogress(fit_lobes(captured, self._surface, self._texels.quad_indices), 0.0, 0.8)
        dome_views = [DomeView(self._store, view) for view in range(len(self._views))]
        lobes = replace(lobes, shadows=shadows, sky_visibility=self._suns.sky_visibility)
        return (yield from subprogress(fit_dome(dome_views, lobes, self._views, self._weights), 0.8, 1.0))
