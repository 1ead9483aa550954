"""What the finished views of a bake tell, as fits and factorisations read it."""

from dataclasses import dataclass

import numpy as np

from ..progress import Progress, Steps
from .shards import ShardStore


@dataclass(frozen=True)
class Colours:
    """The colours of a view, see `alternation.ViewData`: a column for every light and channel."""

    store: ShardStore
    view: int

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Visible texels (M,) and (M, L * 3) float32."""
        visible, radiance = self.store.read(self.view, "visible", "radiance")
        return visible, np.ascontiguousarray(radiance.swapaxes(0, 1), np.float32).reshape(len(visible), 3 * len(radiance))


@dataclass(frozen=True)
class Domes:
    """The colours of a view under the dome alone."""

    store: ShardStore
    view: int

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Visible texels (M,) and (M, 3) float32."""
        visible, radiance = self.store.read(self.view, "visible", "radiance")
        return visible, radiance[-1].astype(np.float32)


@dataclass(frozen=True)
class Rest:
    """What is left of a view's colours to be factorised, see `ShardStore.write_rest`."""

    store: ShardStore
    view: int

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Visible texels (M,) and (M, L * 3) float32."""
        visible, rest = self.store.read_rest(self.view)
        return visible, rest.astype(np.float32)


@dataclass(frozen=True)
class Silhouettes:
    """What the coverage of N texels from V views has more than that from everywhere, `plain` (N,) float32; see `columns.Columns`.

    coverage (V, N) uint8, of 255, and known (V, N) bool: see `Sighting`. weights (V,) float32: what each view counts.
    """

    plain: np.ndarray
    coverage: np.ndarray
    known: np.ndarray
    weights: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """V, N."""
        return self.known.shape

    def read(self, rows: slice | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `columns.Columns`."""
        return self.coverage[:, rows] / np.float32(255.0) - self.plain[rows], self.known[:, rows] * self.weights[:, None]


def silhouettes(store: ShardStore, plain: np.ndarray, weights: np.ndarray) -> Steps[Silhouettes]:
    """The silhouettes of all views in `store`; raises like `ShardStore.read`."""
    coverage, known = np.empty((len(weights), len(plain)), np.uint8), np.empty((len(weights), len(plain)), bool)
    for view in range(len(weights)):
        yield Progress(view / len(weights), "Reading silhouettes")
        known_bits, coverage[view] = store.read(view, "known", "coverage")
        known[view] = np.unpackbits(known_bits, count=len(plain))
    return Silhouettes(plain.astype(np.float32), coverage, known, weights.astype(np.float32))
