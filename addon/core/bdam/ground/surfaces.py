"""The finest data of a store as the ground that objects are put on."""

import numpy as np

from ..store.terrain_store import TerrainStore
from ..view.extraction import extract_uniform_cut
from .heights import HeightQuery


class StoreSurface:
    """The finest triangles of a store, whose heights are multiplied by `exaggeration`, in the space of a terrain; see `Surface`.

    Coarser patches replace those that turn out to be damaged, see `store.patch_links`.
    """

    def __init__(self, store: TerrainStore, exaggeration: float) -> None:
        self._store, self._query, self._exaggeration = store, HeightQuery(store), exaggeration
        self.damages: list[str] = []

    def find(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return heights and normals; see `Surface.find`."""
        for attempt in self._store.attempts():
            if attempt:
                self._query = HeightQuery(self._store, extract_uniform_cut(self._store, 0.0))
            heights, normals = self._query.find(points[:, :2])
            self.damages += [sentence for sentence in self._query.damages if sentence not in self.damages]
        normals = normals / [1.0, 1.0, self._exaggeration]
        return heights * self._exaggeration, normals / np.linalg.norm(normals, axis=1, keepdims=True)
