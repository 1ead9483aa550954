"""Estimates for the panel, computed once per state of the selection and settings, in the background."""

from dataclasses import dataclass
from itertools import zip_longest

import bpy

from ...bridge.billboards import clouds
from ...bridge.billboards.scene_clouds import clouds_of_levels
from ...bridge.geometry.meshes import is_collection_instance
from ...core.billboards.estimate import LevelEstimate
from ...core.billboards.settings import BillboardSettings
from ...core.billboards.trial import Trial, estimate_by_trial, prepare_trial
from ...core.errors import FarfieldError
from ...core.jobs.progress import BackgroundThread, Steps, run_to_end
from .. import long_work
from .sources import read_sources

MAX_AUTOMATIC_FACES = 200_000  # Larger selections are estimated only on request: reading them would block the interface too long.
MAX_AUTOMATIC_CLOUDS = 12  # More are estimated only on request, too: each takes a second or more.
DELAY = 0.3  # Seconds without a change before an automatic estimate starts.
POLL_SECONDS = 0.1  # Between two looks whether an automatic estimate has ended.


@dataclass(frozen=True)
class EstimateKey:
    """The input of an estimate. objects: name, number of vertices, number of faces, matrix and parent of each selected object, and of the
    originals of selected clouds. selected_count: number of selected objects, which come first."""

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
    """The latest estimate, the trials that it was computed from, and the estimate to compute next or in the background."""

    def __init__(self) -> None:
        self._result: tuple[EstimateKey, EstimateResult] | None = None
        self._trials: tuple[tuple, list[Trial]] | None = None
        self._pending: EstimateKey | None = None
        self._thread: BackgroundThread[list[LevelEstimate]] | None = None  # Computes the estimate for `_pending`.
        self._timer = self._advance_pending  # One bound method: Blender recognizes a timer by the identity of its function.

    def find(self, key: EstimateKey) -> EstimateResult | None:
        """Return the result for `key` if it is known."""
        self._evict_deleted()
        return self._result[1] if self._result is not None and self._result[0] == key else None

    def request(self, key: EstimateKey) -> bool:
        """Schedule the estimate for `key`. Return whether it is scheduled: not for large selections, nor while a job runs."""
        cloud_count = 1 if key.combine_selected else key.selected_count
        if sum(item[2] for item in key.objects) > MAX_AUTOMATIC_FACES or cloud_count > MAX_AUTOMATIC_CLOUDS:
            return False
        if long_work.current_run() is not None:
            return False
        if key == self._pending:
            return True
        self._cancel_pending()
        self._pending = key
        bpy.app.timers.register(self._timer, first_interval=DELAY)
        return True

    def compute(self, context: bpy.types.Context, key: EstimateKey) -> EstimateResult:
        """Compute and store the result for `key`.

        Raises:
            FarfieldError: no cloud can be built from the objects.
        """
        self._result = key, EstimateResult(run_to_end(_estimate(self._read_trials(context, key), key.settings)))
        return self._result[1]

    def clear(self) -> None:
        """Discard all results and the scheduled estimate."""
        self._result = self._trials = None
        self._cancel_pending()

    def _read_trials(self, context: bpy.types.Context, key: EstimateKey) -> list[Trial]:
        """Return the trials of the objects of `key`. Raises FarfieldError, see `compute`."""
        trials_key = (key.objects, key.combine_selected)
        if self._trials is None or self._trials[0] != trials_key:
            objects = [bpy.data.objects[item[0]] for item in key.objects[: key.selected_count]]
            sources, _ = read_sources(context, objects, key.combine_selected)
            self._trials = trials_key, [prepare_trial(source.geometry, source.name) for source in sources]
        return self._trials[1]

    def _advance_pending(self) -> float | None:
        """Begin the pending estimate, or store its result if it has ended. Returns the seconds until the next call, None for none."""
        key = self._pending
        if long_work.current_run() is not None or not _all_exist(key.objects):
            self._cancel_pending()
            return None
        try:
            if self._thread is None:
                self._thread = BackgroundThread(_estimate(self._read_trials(bpy.context, key), key.settings))
            if not self._thread.is_done:
                return POLL_SECONDS
            self._result = key, EstimateResult(self._thread.result())
        except FarfieldError as error:
            self._result = key, EstimateResult([], str(error))
        self._pending = self._thread = None
        long_work.redraw_sidebars(bpy.context.window_manager)
        return None

    def _evict_deleted(self) -> None:
        """Discard results of objects that were deleted or renamed."""
        if self._result is not None and not _all_exist(self._result[0].objects):
            self._result = None
        if self._trials is not None and not _all_exist(self._trials[0][0]):
            self._trials = None

    def _cancel_pending(self) -> None:
        """Forget the pending estimate; its thread ends soon."""
        if self._thread is not None:
            self._thread.cancel()
        self._pending = self._thread = None
        if bpy.app.timers.is_registered(self._timer):
            bpy.app.timers.unregister(self._timer)


cache = EstimateCache()


def estimate_key(context: bpy.types.Context, settings: BillboardSettings) -> EstimateKey:
    """Return the key of the current selection and settings. Cheap enough for every redraw."""
    selected = context.selected_objects
    has_levels = any(clouds.KIND in item for item in selected)
    originals = [source for cloud in clouds_of_levels(context.scene, selected) for source in cloud.sources] if has_levels else []
    objects = tuple(
        (item.name, *_counts(item), *(round(value, 6) for row in item.matrix_world for value in row), item.parent and item.parent.name)
        for item in (*selected, *originals)
    )
    return EstimateKey(objects, len(selected), context.scene.farfield_billboards.combine_selected, settings)


def _all_exist(objects: tuple[tuple, ...]) -> bool:
    return all(item[0] in bpy.data.objects for item in objects)


def _counts(item: bpy.types.Object) -> tuple[int, int]:
    """Return the number of vertices and faces of an object, or of those in the collection that it shows, before modifiers."""
    shown = item.instance_collection.all_objects if is_collection_instance(item) and item.instance_collection is not None else [item]
    meshes = [part.data for part in shown if part.type == "MESH"]
    return sum(len(mesh.vertices) for mesh in meshes), sum(len(mesh.polygons) for mesh in meshes)


def _estimate(trials: list[Trial], settings: BillboardSettings) -> Steps[list[LevelEstimate]]:
    """Estimate the levels of all clouds together; some have fewer levels than others."""
    clouds_levels = []
    for trial in trials:
        clouds_levels.append((yield from estimate_by_trial(trial, settings)))
    return [_sum([level for level in levels if level is not None]) for levels in zip_longest(*clouds_levels)]


def _sum(levels: list[LevelEstimate]) -> LevelEstimate:
    return LevelEstimate(
        error=max(level.error for level in levels),
        triangles=sum(level.triangles for level in levels),
        mesh_triangles=sum(level.mesh_triangles for level in levels),
        quads=sum(level.quads for level in levels),
        texels=sum(level.texels for level in levels),
        bytes=sum(level.bytes for level in levels),
    )
