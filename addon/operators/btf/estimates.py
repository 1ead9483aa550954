"""Estimated cost of a bake, and the progress of a cancelled one. Cheap enough for every redraw of the panel."""

import hashlib
from pathlib import Path

import bpy
import numpy as np

from ...bridge.billboards import clouds
from ...bridge.billboards.level_objects import read_level_texels
from ...bridge.billboards.scene_clouds import SceneCloud
from ...bridge.btf.capture.snapshot import store_folder
from ...core.billboards.texels import Texels
from ...core.btf.capture.shards import ShardStore
from ...core.btf.estimate import BakeEstimate, LevelExtent, estimate_bake, image_resolution
from ...core.btf.settings import BtfSettings
from ...core.errors import FileError, SettingsError
from ...core.jobs.executors import parse_executor
from ..user_cache import cache_folder


class EstimateCache:
    """The level extents of the latest cloud, and per cloud the pace of its last bake of this session relative to its estimate.

    Clouds are identified by the session UID of their collection, so a renamed cloud keeps its pace. Entries of deleted clouds are evicted.
    """

    def __init__(self) -> None:
        self._extents: tuple[tuple, list[LevelExtent]] | None = None
        self._paces: dict[int, float] = {}
        self._last_pace = 1.0

    def estimate(self, cloud: SceneCloud, settings: BtfSettings) -> BakeEstimate:
        """Estimate a bake of all levels of `cloud`, at the pace of its last bake in this session, or else of the last bake of any cloud.

        Raises:
            SettingsError: if the executor does not exist.
        """
        self._evict_deleted()
        processes = parse_executor(settings.executor).processes
        return estimate_bake(self._level_extents(cloud), settings, processes, self._pace(cloud))

    def remember_pace(self, cloud: SceneCloud, settings: BtfSettings, seconds: float) -> None:
        """Use the measured duration of a complete bake for later estimates."""
        expected = self.estimate(cloud, settings).seconds / self._pace(cloud)
        self._last_pace = self._paces[cloud.collection.session_uid] = seconds / expected

    def clear(self) -> None:
        """Discard all entries."""
        self._extents, self._last_pace = None, 1.0
        self._paces.clear()

    def _pace(self, cloud: SceneCloud) -> float:
        return self._paces.get(cloud.collection.session_uid, self._last_pace)

    def _level_extents(self, cloud: SceneCloud) -> list[LevelExtent]:
        """Return the extents of the levels. Computed once per state of a cloud, since this is too slow for every redraw."""
        levels = ((level.name, level["farfield_error"], *level.location) for level in cloud.levels)
        key = (cloud.collection.session_uid, cloud.collection.get(clouds.FINGERPRINT), *levels)
        if self._extents is None or self._extents[0] != key:
            self._extents = key, [_measure_extent(read_level_texels(level)) for level in cloud.levels]
        return self._extents[1]

    def _evict_deleted(self) -> None:
        existing = {collection.session_uid for collection in bpy.data.collections}
        if self._extents is not None and self._extents[0][0] not in existing:
            self._extents = None
        self._paces = {uid: pace for uid, pace in self._paces.items() if uid in existing}


cache = EstimateCache()


def capture_folder(cloud: SceneCloud, settings: BtfSettings) -> Path:
    """Return the folder for finished views of a bake until it ends. It is unique per cloud and per set of renders.

    Raises:
        FileError: the user has no folder for caches.
    """
    errors = " ".join(f"{error:.9g}" for error in cloud.errors)
    key = f"{cloud.collection.get(clouds.FINGERPRINT, '')} {errors} {settings.capture_fingerprint}"
    return cache_folder("btf") / hashlib.sha256(key.encode()).hexdigest()[:16]


def count_finished_views(cloud: SceneCloud, settings: BtfSettings) -> int:
    """Return the number of views of all levels that a cancelled bake has finished."""
    try:
        folder = capture_folder(cloud, settings)
    except FileError:
        return 0  # A bake reports it.
    if not folder.is_dir():
        return 0
    stores = [ShardStore(store_folder(folder, index)) for index in range(len(cloud.levels))]
    return sum(store.exists(view) for store in stores for view in range(settings.view_count))


def settings_error(settings: BtfSettings) -> str:
    """Return the error message for invalid settings, or an empty string."""
    try:
        _ = settings.view_grid, settings.light_grid, parse_executor(settings.executor)
    except SettingsError as error:
        return str(error)
    return ""


def _measure_extent(texels: Texels) -> LevelExtent:
    low, high = texels.positions.min(axis=0), texels.positions.max(axis=0)
    radius = np.linalg.norm(texels.positions - 0.5 * (low + high), axis=1).max()
    return LevelExtent(len(texels), image_resolution(float(radius), texels.texel_size))
