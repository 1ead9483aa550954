"""Estimates for the panel, computed once per state of the selection and settings, and never while the panel is drawn."""

from dataclasses import dataclass

import bpy

from ...bridge.billboards import clouds
from ...bridge.billboards.scene_clouds import clouds_of_levels
from ...core.billboards.estimate import LevelEstimate, SurfaceSample, estimate_levels, sample_geometry
from ...core.billboards.settings import BillboardSettings
from ...core.errors import FarfieldError
from .. import long_work
from .sources import read_sources

MAX_AUTOMATIC_FACES = 200_000  # Larger selections are estimated only on request: reading them would block the interface too long.
DELAY = 0.3  # Seconds without a change before an automatic estimate starts.


@dataclass(frozen=True)
class EstimateKey:
    """The input of an estimate. objects: name, number of vertices, number of faces and matrix of each selected object, and of the originals
    of selected clouds. selected_count: number of selected objects, which come first."""

    objects: tuple[tuple, ...]
    selected_count: int
    combine_selected: bool
    settings: BillboardSettings


@dataclass(frozen=True)
class EstimateResult:
    """The estimate per level, summed over the clouds, or the error message if there is none."""

    levels: list[LevelEstimate]
    error_message: str = ""


class EstimateCache:
    """The latest estimate, the surface samples that it was computed from, and the estimate to compute next."""

    def __init__(self) -> None:
        self._result: tuple[EstimateKey, EstimateResult] | None = None
        self._samples: tuple[tuple, list[SurfaceSample]] | None = None
        self._pending: EstimateKey | None = None
        self._timer = self._compute_pending  # One bound method: Blender recognizes a timer by the identity of its function.

    def find(self, key: EstimateKey) -> EstimateResult | None:
        """Return the result for `key` if it is known."""
        self._evict_deleted()
        return self._result[1] if self._result is not None and self._result[0] == key else None

    def request(self, key: EstimateKey) -> bool:
        """Schedule the estimate for `key`. Return whether it is scheduled: not for large selections, nor while a job runs."""
        if sum(item[2] for item in key.objects) > MAX_AUTOMATIC_FACES or long_work.current_run() is not None:
            return False
        if key == self._pending:
            return True
        self._pending = key
        self._unregister_timer()
        bpy.app.timers.register(self._timer, first_interval=DELAY)
        return True

    def compute(self, context: bpy.types.Context, key: EstimateKey) -> EstimateResult:
        """Compute and store the result for `key`.

        Raises:
            FarfieldError: no cloud can be built from the objects.
        """
        samples_key = (key.objects, key.combine_selected)
        if self._samples is None or self._samples[0] != samples_key:
            objects = [bpy.data.objects[item[0]] for item in key.objects[: key.selected_count]]
            sources, _ = read_sources(context, objects, key.combine_selected)
            self._samples = samples_key, [sample_geometry(source.geometry, source.name) for source in sources]
        per_cloud = [estimate_levels(sample, key.settings) for sample in self._samples[1]]
        self._result = key, EstimateResult([_sum(levels) for levels in zip(*per_cloud, strict=True)])
        return self._result[1]

    def clear(self) -> None:
        """Discard all results and the scheduled estimate."""
        self._result = self._samples = self._pending = None
        self._unregister_timer()

    def _compute_pending(self) -> None:
        key, self._pending = self._pending, None
        if long_work.current_run() is not None or not _all_exist(key.objects):
            return
        try:
            self.compute(bpy.context, key)
        except FarfieldError as error:
            self._result = key, EstimateResult([], str(error))
        long_work.redraw_sidebars(bpy.context.window_manager)

    def _evict_deleted(self) -> None:
        """Discard results of objects that were deleted or renamed."""
        if self._result is not None and not _all_exist(self._result[0].objects):
            self._result = None
        if self._samples is not None and not _all_exist(self._samples[0][0]):
            self._samples = None

    def _unregister_timer(self) -> None:
        if bpy.app.timers.is_registered(self._timer):
            bpy.app.timers.unregister(self._timer)


cache = EstimateCache()


def estimate_key(context: bpy.types.Context, settings: BillboardSettings) -> EstimateKey:
    """Return the key of the current selection and settings. Cheap enough for every redraw."""
    selected = context.selected_objects
    has_levels = any(clouds.KIND in item for item in selected)
    originals = [source for cloud in clouds_of_levels(context.scene, selected) for source in cloud.sources] if has_levels else []
    objects = tuple(
        (item.name, *_counts(item), *(round(value, 6) for row in item.matrix_world for value in row)) for item in (*selected, *originals)
    )
    return EstimateKey(objects, len(selected), context.scene.farfield_billboards.combine_selected, settings)


def _all_exist(objects: tuple[tuple, ...]) -> bool:
    return all(item[0] in bpy.data.objects for item in objects)


def _counts(item: bpy.types.Object) -> tuple[int, int]:
    return (len(item.data.vertices), len(item.data.polygons)) if item.type == "MESH" else (0, 0)


def _sum(levels: tuple[LevelEstimate, ...]) -> LevelEstimate:
    return LevelEstimate(
        error=max(level.error for level in levels),
        quads=sum(level.quads for level in levels),
        triangles=sum(level.triangles for level in levels),
        texels=sum(level.texels for level in levels),
        bytes=sum(level.bytes for level in levels),
    )
