"""The job behind *Load* and *Update*."""

from contextlib import suppress
from dataclasses import dataclass

import bpy
import mathutils
import numpy as np

from ...bridge.bdam import objects as terrain_objects
from ...bridge.bdam.objects import SceneTerrain, TerrainChange
from ...bridge.viewers import describe_camera_range, describe_solid_view, extend_clipping
from ...core.bdam.settings import ViewSettings
from ...core.bdam.view.engine import BdamEngine, Update
from ...core.errors import GeometryError
from ...core.geometry.viewers import Viewer
from ...core.jobs.progress import Progress, Steps
from ...core.messages import join_sentences
from ..engine_cache import cache
from ..view_following import view_of_area

VIEW_DISTANCE = 1.2  # relative to the size of the terrain
ROTATION = mathutils.Euler((1.05, 0.0, 0.0))  # from the south, and down


@dataclass
class ShowJob:
    """Shows a terrain for one viewer: a new terrain, or `terrain` with other settings. Afterwards `terrain` is the result.

    viewer: in the local frame of the store. path: of the store, as a new terrain keeps it.
    """

    core_fraction = 0.5

    engine: BdamEngine
    viewer: Viewer
    path: str
    terrain: SceneTerrain | None = None

    def core_steps(self) -> Steps[Update]:
        """Choose and read the patches."""
        return self.engine.move(self.viewer)

    def scene_steps(self, core_result: Update) -> Steps[str]:
        """Fill meshes, then show them. Returns the message for the user.

        Raises:
            GeometryError: the terrain or its new meshes were removed during the update.
        """
        is_new = self.terrain is None
        if not is_new and self.terrain.root is None:
            raise GeometryError(f'The terrain "{self.terrain.name}" was removed during the update.')
        label = SceneTerrain(terrain_objects.TERRAIN_NAME) if is_new else self.terrain
        change = TerrainChange(label, self.engine)
        blocks, count = self.engine.finished_blocks, self.engine.finished_blocks.qsize()
        while not blocks.empty():
            yield Progress(1.0 - blocks.qsize() / (count + 1), "Creating meshes")
            for _ in change.fill(*blocks.get_nowait()):
                pass
        yield Progress(count / (count + 1), "Showing meshes")
        change.check_pending()
        if is_new:
            self.terrain = terrain_objects.create_root(bpy.context.scene, self.path, self.engine)
            self.terrain.select(bpy.context.view_layer)
        elif self.terrain.root is None:
            raise GeometryError(f'The terrain "{self.terrain.name}" was removed during the update.')
        self.terrain.store_settings(self.engine.settings)
        for _ in change.show_in(self.terrain, core_result):
            pass
        cache.store(self.terrain, self.engine)
        message = f'"{self.terrain.name}": {core_result.figures.triangles:,} triangles in {core_result.figures.tiles} tiles.'
        message = join_sentences([message, core_result.figures.describe_budget()])
        low, high = self.engine.bounds
        size = float(np.linalg.norm(high - low))
        if not is_new:
            return join_sentences([message, *core_result.warnings[:1]])
        return join_sentences([describe_camera_range(bpy.context.scene, size), message, *core_result.warnings[:1], describe_solid_view()])


def prepare_load(
    scene: bpy.types.Scene,
    directory: str,
    settings: ViewSettings,
    area: bpy.types.Area | None,
    *,
    is_relative: bool = True,
    frame_view: bool = True,
) -> ShowJob:
    """Return the job that shows the terrain in the folder `directory` for a 3D Viewport.

    is_relative: whether the scene stores the path relative to its file, if it has one. frame_view: whether the viewport shows all of it.

    Raises:
        FileError, SettingsError: the store cannot be read.
    """
    folder = terrain_objects.resolve_folder(directory, None, "The terrain")
    path = terrain_objects.store_path(directory)
    if is_relative and bpy.data.filepath:
        with suppress(ValueError):  # on another drive
            path = bpy.path.relpath(str(folder))
    engine = BdamEngine(folder, settings)
    if frame_view and area is not None:
        frame_terrain(area.spaces.active, *engine.bounds, settings.exaggeration)
    return ShowJob(engine, view_of_area(scene, area), path)


def frame_terrain(space: bpy.types.SpaceView3D, low: np.ndarray, high: np.ndarray, exaggeration: float) -> None:
    """Let a 3D Viewport show a terrain between two corners (3,) of its bounding box, and extend its clipping range.

    A view through the camera stays as it is.
    """
    scale = np.array([1.0, 1.0, exaggeration])
    center, size = 0.5 * (low + high) * scale, float(np.linalg.norm((high - low) * scale))
    extend_clipping(space, size)
    region = space.region_3d
    if region.view_perspective == "CAMERA":
        return
    region.view_location, region.view_distance = center.tolist(), VIEW_DISTANCE * float((high - low)[:2].max())
    region.view_rotation = ROTATION.to_quaternion()
    region.update()


def prepare_update(terrain: SceneTerrain, settings: ViewSettings, viewer: Viewer) -> ShowJob:
    """Return the job that shows all of a terrain again for a viewer in world space.

    Raises:
        FileError, SettingsError: the store or the position of the terrain cannot be read.
    """
    return ShowJob(BdamEngine(terrain.folder, settings), terrain.to_terrain_space(viewer), terrain.root[terrain_objects.STORE_KEY], terrain)
