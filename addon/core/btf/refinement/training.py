"""Training views of the refinement: the finished views of a bake, with their fragments cached in memory or in the work folder."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from threading import Lock

import numpy as np

from ...billboards.texels import QuadPolygons, Texels
from ...geometry.cameras import OrthographicView
from ...jobs.chunks import map_ordered
from ...jobs.progress import Progress, Steps, subprogress
from ..capture.shard_files import ViewFiles
from ..capture.shards import ShardStore
from ..factorization.factors import Factors
from .fragments import Fragments, find_fragments
from .refine import RAYS_PER_SIDE, TrainingView, cull_hidden, refine_alpha, shade

SHADING_END = 0.3  # End of shading in the progress of a refinement.
FRAGMENT_ARRAYS = ("ray_count", "ray_indices", "texel_indices", "weights", "colors")
MAX_MEMORY_BYTES = 4e8  # Memory for fragments and colors; those of further views go to files.


@dataclass
class _Cache:
    """Fragments and colors by view index, and the depth complexity of views. Several threads may add entries at once."""

    free_bytes: float = MAX_MEMORY_BYTES
    entries: dict[int, tuple[Fragments, np.ndarray]] = field(default_factory=dict)
    max_depth_complexity: dict[int, int] = field(default_factory=dict)
    lock: Lock = field(default_factory=Lock)

    def add(self, view: int, fragments: Fragments, colors: np.ndarray) -> bool:
        """Add an entry if it fits into memory; return whether it did."""
        with self.lock:
            fits = fragments.nbytes + colors.nbytes <= self.free_bytes
            if fits:
                self.free_bytes -= fragments.nbytes + colors.nbytes
                self.entries[view] = fragments, colors
        return fits


@dataclass(frozen=True)
class StoredTrainingView:
    """A finished view of a bake; see `refine.TrainingViewSource`.

    Attributes:
        quads: Polygons of the level.
        texels: Texels of the level.
        view: The view.
        store: Finished views of the level.
        index: Index of the view.
        cache: Fragments of all views that are in memory.
    """

    quads: QuadPolygons
    texels: Texels
    view: OrthographicView
    store: ShardStore
    index: int
    cache: _Cache

    def find_fragments(self) -> Fragments:
        """Intersect the rays of the view with the quads."""
        fragments = find_fragments(self.quads, self.texels, self.view, RAYS_PER_SIDE)
        self.cache.max_depth_complexity[self.index] = fragments.max_depth_complexity
        return fragments

    def max_depth_complexity(self) -> int:
        """Return the largest number of quads along one ray. Calls `find_fragments` if that has not happened yet."""
        if self.index not in self.cache.max_depth_complexity:
            self.find_fragments()
        return self.cache.max_depth_complexity[self.index]

    def store_fragments(self, fragments: Fragments, colors: np.ndarray) -> None:
        """Store fragments and colors for `load`. Raises FileError when they do not fit into memory and the file cannot be written."""
        if not self.cache.add(self.index, fragments, colors):
            arrays = fragments.ray_indices, fragments.texel_indices, fragments.weights, colors
            names_and_arrays = zip(FRAGMENT_ARRAYS, (np.array(fragments.ray_count), *arrays), strict=True)
            fragment_files(self.store).write(self.index, dict(names_and_arrays))

    def load(self) -> TrainingView:
        """Return the stored fragments and colors, and the reference image. Raises FileError."""
        if self.index in self.cache.entries:
            fragments, colors = self.cache.entries[self.index]
        else:
            ray_count, *arrays, colors = fragment_files(self.store).read(self.index, *FRAGMENT_ARRAYS)
            fragments = Fragments(int(ray_count), *arrays)
        return TrainingView(fragments, colors, self.store.read_reference(self.index))


def fragment_files(store: ShardStore) -> ViewFiles:
    """Return the files of fragments and their colors (F, D) float16 in the folder of `store`. They exist during refinement only."""
    return ViewFiles(store.folder, "fragments")


def refine_stored_views(
    views: Sequence[StoredTrainingView],
    alpha: Factors,
    pbr_alpha: np.ndarray,
    view_weights: np.ndarray,
    texel_colors: Callable[[int, np.ndarray], np.ndarray],
    is_drawn: Callable[[int], np.ndarray] | None = None,
) -> Steps[Factors]:
    """Store the fragments of all `views` that are not hidden, and return the refined `alpha`; see `refine_alpha`.

    texel_colors: colors (N, D) of all texels in a view; only those of the given rows count. is_drawn: which texels (N,) bool a view shows;
    None for all.

    Raises:
        FileError: the fragments do not fit into memory and cannot be written.
    """

    def store_view(index: int) -> None:
        fragments = views[index].find_fragments()
        if is_drawn is not None:
            fragments = fragments.subset(is_drawn(index)[fragments.texel_indices[:, 0]])
        fragments = cull_hidden(fragments, pbr_alpha + alpha.reconstruct(alpha.basis[index])[:, 0])
        colors = texel_colors(index, np.unique(fragments.texel_indices))
        views[index].store_fragments(fragments, shade(fragments, colors))

    try:
        for index, _ in enumerate(map_ordered(store_view, range(len(views)))):
            yield Progress(SHADING_END * index / len(views), "Shading")
        return (yield from subprogress(refine_alpha(views, alpha, pbr_alpha, view_weights), SHADING_END, 1.0))
    finally:
        fragment_files(views[0].store).remove_all()


def training_views(quads: QuadPolygons, texels: Texels, views: Sequence[OrthographicView], store: ShardStore) -> list[StoredTrainingView]:
    """Return the training views of all `views`, which must be finished in `store`."""
    cache = _Cache()
    return [StoredTrainingView(quads, texels, view, store, index, cache) for index, view in enumerate(views)]
