"""Residual radiance: captured radiance without lobes, divided by the chromaticity. This is what the components represent."""

from dataclasses import dataclass

import numpy as np

from ...geometry.directions import DirectionGrid
from ...jobs.chunks import map_ordered
from ...jobs.progress import Progress, Steps
from ..capture.shard_files import ViewFiles, to_half
from ..capture.shards import ShardStore
from ..capture.view_data import RadianceView
from ..factorization.als import split_lights
from .disc_lights import DiscLights
from .lobes import Lobes

MAX_RESIDUAL, MAX_DOME_RESIDUAL = 0.5 / np.pi, 1.0  # Radiance under a sun and under the dome; larger residuals are misplaced highlights.
MIN_RESIDUAL, MIN_DOME_RESIDUAL = -1.0 / np.pi, -1.0  # A white surface that is in shadow, but not for the lobes.


@dataclass(frozen=True)
class ResidualView:
    """The residuals of a view; see `als.ViewData`."""

    files: ViewFiles
    view: int

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the visible texels (M,) and their residuals (M, L * 3) float32. Raises FileError."""
        visible, residuals = self.files.read(self.view, "visible", "residuals")
        return visible, residuals.astype(np.float32)


def residual_files(store: ShardStore) -> ViewFiles:
    """Return the files of residuals in the folder of `store`: `visible` (M,) and `residuals` (M, L * 3) as half floats.

    They exist during compression only.
    """
    return ViewFiles(store.folder, "residuals")


def write_residuals(
    store: ShardStore, chromaticity: np.ndarray, lobes: Lobes | None, views: DirectionGrid, suns: DiscLights
) -> Steps[list[ResidualView]]:
    """Write the residuals of all `views` in `store`: radiance minus that of `lobes`, divided by `chromaticity` (N, 3).

    Residuals under `lobes` are clamped to MIN_RESIDUAL..MAX_RESIDUAL. Larger values are highlights that their lobe shows elsewhere; they
    are the largest of all and would use up the components.
    """
    files = residual_files(store)

    def write_view(view: int) -> ResidualView:
        visible, values = RadianceView(store, view).read()
        values = split_lights(values)
        if lobes is not None:
            values = values - lobes.radiance_on_grid(views.directions[view], suns, visible)
            values[:, :-1] = np.clip(values[:, :-1], MIN_RESIDUAL, MAX_RESIDUAL)
            values[:, -1] = np.clip(values[:, -1], MIN_DOME_RESIDUAL, MAX_DOME_RESIDUAL)
        residuals = (values / chromaticity[visible, None]).reshape(len(visible), 3 * values.shape[1])
        files.write(view, {"visible": visible, "residuals": to_half(residuals)})
        return ResidualView(files, view)

    residual_views = []
    for residual_view in map_ordered(write_view, range(len(views))):
        yield Progress(len(residual_views) / len(views), "Subtracting highlights")
        residual_views.append(residual_view)
    return residual_views
