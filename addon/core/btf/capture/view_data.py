"""Datasets over the finished views of a bake, in the form that fits and factorizations read."""

from dataclasses import dataclass

import numpy as np

from ...jobs.progress import Progress, Steps
from .shards import ShardStore


@dataclass(frozen=True)
class RadianceView:
    """The captured radiance of a view (see `als.ViewData`), with one column per light and channel."""

    store: ShardStore
    view: int

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the visible texels (M,) and their radiance (M, L * 3) float32."""
        visible, radiance = self.store.read(self.view, "visible", "radiance")
        return visible, np.ascontiguousarray(radiance.swapaxes(0, 1), np.float32).reshape(len(visible), 3 * len(radiance))


@dataclass(frozen=True)
class DomeView:
    """The captured radiance of a view under the dome alone (see `als.ViewData`)."""

    store: ShardStore
    view: int

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the visible texels (M,) and their radiance (M, 3) float32."""
        visible, radiance = self.store.read(self.view, "visible", "radiance")
        return visible, radiance[-1].astype(np.float32)


@dataclass(frozen=True)
class Silhouettes:
    """Coverage of N texels from V views minus their view-independent coverage `pbr_alpha` (N,) float32; see `als_scalar.ScalarData`.

    coverage (V, N) uint8, 0..255, and known (V, N) bool: see `Observation`. weights (V,) float32: weight of each view.
    """

    pbr_alpha: np.ndarray
    coverage: np.ndarray
    known: np.ndarray
    weights: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Number of views V and of texels N."""
        return self.known.shape

    def read(self, rows: slice | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return values (V, M) and weights (V, M) of the texels `rows`; see `ScalarData`."""
        return self.coverage[:, rows] / np.float32(255.0) - self.pbr_alpha[rows], self.known[:, rows] * self.weights[:, None]


def read_silhouettes(store: ShardStore, pbr_alpha: np.ndarray, weights: np.ndarray) -> Steps[Silhouettes]:
    """Read the silhouettes of all views in `store`. Raises FileError."""
    coverage, known = np.empty((len(weights), len(pbr_alpha)), np.uint8), np.empty((len(weights), len(pbr_alpha)), bool)
    for view in range(len(weights)):
        yield Progress(view / len(weights), "Reading silhouettes")
        known_bits, coverage[view] = store.read(view, "known", "coverage")
        known[view] = np.unpackbits(known_bits, count=len(pbr_alpha))
    return Silhouettes(pbr_alpha.astype(np.float32), coverage, known, weights.astype(np.float32))
