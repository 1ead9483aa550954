"""The jobs behind the buttons and the script: a new terrain, a terrain made anew with other settings."""

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..bridge import terrain_objects
from ..bridge.terrain_materials import Cover, terrain_material
from ..bridge.terrain_objects import StandingTerrain
from ..core.clipbox.layout import good_origin
from ..core.clipbox.settings import ClipboxSettings
from ..core.clipbox.terrain import NO_SURFACE, Terrain, Update, check_viewer
from ..core.errors import FileError, GeometryError
from ..core.progress import Progress, Steps, scaled
from . import clipbox_engines

LOW, HIGH = 10, 90  # percentiles of the heights of vertices, between which most ground is green


@dataclass
class ClipboxJob:
    """Builds a terrain about a viewer: a new one, or `standing` with other settings. `standing` is it, once the job is done."""

    core_share = 0.9

    engine: Terrain
    settings: ClipboxSettings
    viewer: np.ndarray
    standing: StandingTerrain | None = None
    update: Update | None = None

    def core_steps(self) -> Steps[Update]:
        """Work out voxels and surfaces."""
        return self.engine.move(self.viewer)

    def scene_steps(self, core_result: Update) -> Steps[str]:
        """Show them.

        Raises:
            GeometryError: when the terrain that was to be made anew has gone, or there is no surface within the boxes.
        """
        settings = self.settings
        if not core_result.meshes:
            raise GeometryError(NO_SURFACE)
        origin = self.standing.origin if self.standing is not None else good_origin(self.viewer, settings)
        meshes = yield from scaled(terrain_objects.filled(core_result, origin, settings), 0.0, 0.99)
        yield Progress(0.99, "Showing")
        cover = cover_of(settings, origin)
        if self.standing is None:
            self.standing = terrain_objects.new_root(bpy.context.scene, settings, self.viewer, origin)
            terrain_objects.choose(bpy.context.view_layer, self.standing)
        elif self.standing.root is None:
            raise GeometryError(f'The terrain "{self.standing.name}" was removed meanwhile.')
        terrain_objects.keep_settings(self.standing.root, settings)
        material = self.standing.material or terrain_material(
            self.standing.name, self.standing.root, *heights(core_result, origin), cover, wooded=settings.terrain == "forest"
        )
        terrain_objects.put_in_place(self.standing, meshes, core_result, material)
        clipbox_engines.keep(self.standing, self.engine)
        self.update = core_result
        triangles = sum(len(mesh.triangles) for mesh in core_result.meshes.values())
        return f'"{self.standing.name}": {triangles:,} triangles in {settings.boxes} boxes.'


def prepare(settings: ClipboxSettings, viewer: np.ndarray, standing: StandingTerrain | None = None) -> ClipboxJob:
    """The job that makes a terrain about `viewer` (3,), a place in the terrain, or `standing` anew.

    Raises:
        SettingsError, FileError, GeometryError: when the formula, the file or the place is no good.
    """
    check_viewer(viewer, settings.voxel)
    cover_of(settings, np.zeros(3))  # before any work is spent
    return ClipboxJob(clipbox_engines.new_engine(settings), settings, np.array(viewer, np.float64), standing)


def cover_of(settings: ClipboxSettings, origin: np.ndarray) -> Cover | None:
    """The picture that a height map is covered with, if there is one.

    Raises:
        FileError: when there is no such file.
    """
    if settings.terrain != "heights" or not settings.source_color:
        return None
    path = Path(bpy.path.abspath(settings.source_color))
    if not path.is_file():
        raise FileError(f'There is no picture "{path}"; check the path.')
    return Cover(path, settings.source_size * settings.scale, origin)


def heights(update: Update, origin: np.ndarray) -> tuple[float, float]:
    """Between which heights from the root most of the ground lies, in scene units."""
    found = np.concatenate([mesh.vertices[:, 2] for mesh in update.meshes.values()]) - origin[2]
    return tuple(np.percentile(found, (LOW, HIGH)).tolist())
