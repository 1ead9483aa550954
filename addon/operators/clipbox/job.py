"""The job behind *Create* and *Update*, and behind the script."""

from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from ...bridge.clipbox import objects as terrain_objects
from ...bridge.clipbox import sources
from ...bridge.clipbox.edits import read_edits
from ...bridge.clipbox.materials import GroundImage, create_terrain_material
from ...bridge.clipbox.objects import SceneTerrain
from ...bridge.clipbox.sources import absolute_path
from ...bridge.imaging.image_files import check_openexr
from ...bridge.viewers import describe_camera_range, describe_solid_view
from ...core.clipbox.engine import NO_SURFACE, TerrainEngine, Update, check_viewer
from ...core.clipbox.files.readers import BLEND_PREFIX, check_path
from ...core.clipbox.layout import choose_terrain_origin
from ...core.clipbox.settings import ClipboxSettings
from ...core.errors import GeometryError
from ...core.files.file_access import check_readable
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.messages import format_count, join_sentences, quote_names
from ..engine_cache import cache

HEIGHT_PERCENTILES = 10, 90  # percentiles of the heights of vertices between which most ground has the color of grass


@dataclass
class TerrainJob:
    """Builds a terrain around a viewer: a new one, or `terrain` with other settings.

    Attributes:
        engine: computes the terrain.
        settings: the settings that the scene stores.
        viewer: (3,) float64, terrain position.
        terrain: the terrain to rebuild; afterwards the result.
        update: what was shown, None before.
    """

    core_fraction = 0.9

    engine: TerrainEngine
    settings: ClipboxSettings
    viewer: np.ndarray
    terrain: SceneTerrain | None = None
    update: Update | None = None

    def core_steps(self) -> Steps[Update]:
        """Compute voxels and surfaces."""
        return self.engine.move(self.viewer)

    def scene_steps(self, core_result: Update) -> Steps[str]:
        """Show the surfaces. Returns the message for the user.

        Raises:
            GeometryError: the boxes contain no surface, or undo has removed the terrain to update or its new meshes.
        """
        settings = self.settings
        if not core_result.meshes:
            raise GeometryError(NO_SURFACE)
        origin = self.terrain.origin if self.terrain is not None else choose_terrain_origin(self.viewer, settings)
        pending = yield from subprogress(terrain_objects.fill_meshes(core_result, origin, settings), 0.0, 0.99)
        yield Progress(0.99, "Showing meshes")
        pending.check()
        ground_image = find_ground_image(settings, origin)
        is_rebuilt = self.terrain is not None
        others = [] if is_rebuilt else SceneTerrain.in_scene(bpy.context.scene)
        if self.terrain is None:
            self.terrain = terrain_objects.create_root(bpy.context.scene, settings, self.viewer, origin)
            self.terrain.select(bpy.context.view_layer)
        elif self.terrain.root is None:
            raise GeometryError(f'The terrain "{self.terrain.name}" was removed during the update.')
        self.terrain.store_settings(settings)
        material = self.terrain.material or create_terrain_material(
            self.terrain.name,
            self.terrain.root,
            *height_range(core_result, origin),
            settings.voxel_size,
            ground_image,
            settings.terrain,
            settings.scale,
            -float(origin[2]),
        )
        terrain_objects.show_meshes(self.terrain, pending, core_result, material)
        terrain_objects.show_water(self.terrain, settings)
        cache.store(self.terrain, self.engine)
        self.update = core_result
        triangles = sum(len(mesh.triangles) for mesh in core_result.meshes.values())
        summary = f'"{self.terrain.name}": {format_count(triangles, "triangle")} in {format_count(settings.boxes, "box")}.'
        hints = [] if is_rebuilt else [describe_camera_range(bpy.context.scene, settings.extent), describe_solid_view()]
        kept = [f"It is in addition to {quote_names(terrain.name for terrain in others)}, which Update changes."] if others else []
        return join_sentences([summary, *kept, *self.engine.warnings, *hints])


def prepare(settings: ClipboxSettings, viewer: np.ndarray, terrain: SceneTerrain | None = None) -> TerrainJob:
    """Return the job that builds a terrain around `viewer` (3,), a terrain position, or that rebuilds `terrain`.

    Raises:
        SettingsError, FileError, GeometryError: the formula, a file or the position is invalid.
    """
    check_viewer(viewer, settings.voxel_size)
    find_ground_image(settings, np.zeros(3))  # before any computation
    edits = read_edits(bpy.context.scene, settings.edit_blend, terrain)
    return TerrainJob(sources.create_engine(settings, edits=edits), keep_blend_paths(settings), np.array(viewer, np.float64), terrain)


def keep_blend_paths(settings: ClipboxSettings) -> ClipboxSettings:
    """Return settings to store in a file: paths relative to the .blend file stay as they are, others become absolute."""
    paths = {name: getattr(settings, name) for name in ("source", "source_color")}
    return replace(settings, **{name: absolute_path(path) for name, path in paths.items() if path and not path.startswith(BLEND_PREFIX)})


def find_ground_image(settings: ClipboxSettings, origin: np.ndarray) -> GroundImage | None:
    """Return the image that colors a height map, None if there is none.

    Raises:
        FileError: the file is missing, damaged or cannot be read, or its path is relative to a .blend file that was never saved.
    """
    if settings.terrain != "heights" or not settings.source_color:
        return None
    path = Path(absolute_path(settings.source_color))
    check_path(str(path))
    check_readable(path)
    check_openexr(path)
    return GroundImage(path, settings.source_size * settings.scale, origin)


def height_range(update: Update, origin: np.ndarray) -> tuple[float, float]:
    """Return the heights above the root, in scene units, between which most of the ground lies."""
    heights = np.concatenate([mesh.vertices[:, 2] for mesh in update.meshes.values()]) - origin[2]
    return tuple(np.percentile(heights, HEIGHT_PERCENTILES).tolist())
