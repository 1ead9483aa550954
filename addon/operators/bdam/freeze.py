"""The operators *Freeze* and *Freeze Camera Path*."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import bpy

from ...bridge.bdam import freezing as freezing_bridge
from ...bridge.bdam import objects as terrain_objects
from ...bridge.bdam.materials import TileMaterials, remove_unused
from ...bridge.bdam.objects import SceneTerrain
from ...bridge.viewers import camera_viewer
from ...core.bdam.settings import FreezePathSettings, FreezeSettings, ViewSettings
from ...core.bdam.view.engine import BdamEngine
from ...core.bdam.view.freezing import FrozenMesh, choose_path_cut, describe_limit, freeze_cut, join
from ...core.errors import GeometryError, SettingsError
from ...core.geometry.viewers import Viewer
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.messages import format_count, join_sentences
from .. import follow_handlers, properties, start_job
from ..engine_cache import cache
from ..view_following import ActiveTerrainOperator

VIEWERS_FRACTION, CUT_FRACTION, MESHES_FRACTION = 0.4, 0.5, 0.8  # progress at which each part ends
Key = int | str | None


@dataclass
class FreezeJob:
    """Makes objects of the tiles of a terrain. Afterwards `object_names` has their names."""

    core_fraction = 0.8

    terrain: SceneTerrain
    meshes: list[FrozenMesh]
    settings: FreezeSettings
    object_names: tuple[str, ...] = ()

    def core_steps(self) -> Steps[list[FrozenMesh]]:
        """Join the meshes, if wanted."""
        yield Progress(0.0, "Joining meshes")
        return [join(self.meshes)] if self.settings.joined else self.meshes

    def scene_steps(self, core_result: list[FrozenMesh]) -> Steps[str]:
        """Create the objects, and remove the terrain unless it is to be kept. Returns the message for the user."""
        yield Progress(0.5, "Creating objects")
        check_exists(self.terrain)
        self.object_names, message = create_objects(
            self.terrain, core_result, self.settings, lambda name: bpy.data.materials.get(name or "")
        )
        return message


@dataclass
class FreezePathJob:
    """Makes objects that are fine enough for the active camera in a range of frames.

    It steps through the frames, so nearly all of it needs the scene. The frame, and what follows the camera, is restored.

    Attributes:
        terrain: the terrain.
        folder: its store.
        view_settings: how it is shown.
        settings: the objects to create.
        frames: the frames.
        object_names: afterwards the names of the objects.
        viewers: the camera in the frames, as far as it was read, in the local frame of the store.
    """

    core_fraction = 0.01

    terrain: SceneTerrain
    folder: Path
    view_settings: ViewSettings
    settings: FreezeSettings
    frames: list[int]
    object_names: tuple[str, ...] = ()
    viewers: list[Viewer] = field(default_factory=list)

    def core_steps(self) -> Steps[BdamEngine]:
        """Open the store."""
        yield Progress(0.0, "Opening the terrain")
        return BdamEngine(self.folder, self.view_settings)

    def scene_steps(self, core_result: BdamEngine) -> Steps[str]:
        """Read the camera in all frames, choose a cut, and create the objects. Returns the message for the user.

        Raises:
            GeometryError: the terrain or the camera was removed meanwhile.
        """
        store, exaggeration = core_result.store, self.view_settings.exaggeration
        try:
            yield from subprogress(self._read_viewers(), 0.0, VIEWERS_FRACTION)
            for _ in store.attempts():
                textures, cut = yield from subprogress(
                    choose_path_cut(store, self.viewers, self.view_settings), VIEWERS_FRACTION, CUT_FRACTION
                )
                meshes, damages = yield from subprogress(freeze_cut(store, textures, cut, exaggeration), CUT_FRACTION, MESHES_FRACTION)
            if not meshes:
                raise GeometryError(f'The terrain "{self.terrain.name}" has no triangles that can be read; verify its store.')
            yield Progress(MESHES_FRACTION, "Joining meshes")
            meshes = [join(meshes)] if self.settings.joined else meshes
            check_exists(self.terrain)
            materials = TileMaterials(core_result, self.terrain.name)
            general = self.terrain.ensure_material(self.view_settings.shading, core_result)
            numbers = {key for mesh in meshes for key in mesh.materials if key is not None}
            missing = sorted(numbers - materials.find_all(numbers).keys())
            for index, number in enumerate(missing):
                yield Progress(MESHES_FRACTION + (1.0 - MESHES_FRACTION) * index / len(missing), "Creating materials")
                maps, of_maps = core_result.read_maps(number)
                damages = (*damages, *of_maps)
                materials.create(number, self.terrain.name, maps, general, self.terrain.root)
            yield Progress(1.0, "Creating objects")
            check_exists(self.terrain)
            found = materials.find_all(numbers)
            self.object_names, message = create_objects(self.terrain, meshes, self.settings, lambda key: found.get(key, general))
            remove_unused()
            sentences = [message, f"Good for {format_count(len(self.frames), 'frame')}.", describe_limit(textures, self.view_settings)]
            return join_sentences([*sentences, *damages[:1]])
        finally:
            store.close()

    def _read_viewers(self) -> Steps[None]:
        """Read the active camera of every frame, in the local frame of the store."""
        scene = bpy.context.scene
        start, subframe = scene.frame_current, scene.frame_subframe
        with follow_handlers.paused_followers(scene):
            try:
                for index, frame in enumerate(self.frames):
                    yield Progress(index / len(self.frames), "Reading the camera")
                    scene.frame_set(frame)
                    check_exists(self.terrain)
                    if scene.camera is None:
                        raise GeometryError(f"The scene has no active camera in frame {frame}; choose one.")
                    camera = scene.camera.evaluated_get(bpy.context.evaluated_depsgraph_get())
                    viewer = self.terrain.to_terrain_space(camera_viewer(scene, camera))
                    if not self.viewers or not viewer.is_same(self.viewers[-1]):
                        self.viewers.append(viewer)
            finally:
                scene.frame_set(start, subframe=subframe)


def check_exists(terrain: SceneTerrain) -> None:
    """Raise GeometryError if a terrain was removed while a job ran."""
    if terrain.root is None:
        raise GeometryError(f'The terrain "{terrain.name}" was removed meanwhile.')


def create_objects(
    terrain: SceneTerrain, meshes: Sequence[FrozenMesh], settings: FreezeSettings, find_material: Callable[[Key], bpy.types.Material | None]
) -> tuple[tuple[str, ...], str]:
    """Create objects of meshes and remove the terrain unless it is to be kept. Returns the names of the objects, and a message."""
    names = freezing_bridge.add_frozen_meshes(bpy.context.scene, terrain, meshes, find_material)
    name = terrain.name
    if not settings.keep_terrain:
        terrain_objects.remove(terrain)
        cache.evict_missing()
    triangles = sum(len(mesh.triangles) for mesh in meshes)
    return names, f'Froze "{name}" to {format_count(len(names), "object")} with {triangles:,} triangles.'


class FreezeOperator(ActiveTerrainOperator, start_job.StartJob):
    """What *Freeze* and *Freeze Camera Path* have in common."""

    terrain_type, changes_terrain = SceneTerrain, False
    panel_property = "farfield_bdam_freeze"


class FARFIELD_OT_bdam_freeze(FreezeOperator, bpy.types.Operator):
    """Make ordinary meshes of what the active terrain shows now. They do not need Farfield"""

    bl_idname = "farfield.bdam_freeze"
    bl_label = "Freeze Large Terrain"
    bl_options = {"REGISTER", "UNDO"}
    settings_types = (FreezeSettings,)
    __annotations__ = start_job.setting_properties(*settings_types)

    def prepare(self, context: bpy.types.Context) -> FreezeJob:
        """Read the tiles of the active terrain."""
        terrain, settings = self.active_terrain(context), self.read_settings(context)[FreezeSettings]
        check_removal(terrain, settings)
        meshes = freezing_bridge.read_tiles(terrain)
        if not meshes:
            raise GeometryError(f'The terrain "{terrain.name}" shows nothing; press Update first.')
        return FreezeJob(terrain, meshes, settings)


class FARFIELD_OT_bdam_freeze_path(FreezeOperator, bpy.types.Operator):
    """Make ordinary meshes of the active terrain that are fine enough for the active camera in a range of frames"""

    bl_idname = "farfield.bdam_freeze_path"
    bl_label = "Freeze Large Terrain for Camera Path"
    bl_options = {"REGISTER", "UNDO"}
    settings_types = (FreezeSettings, FreezePathSettings)
    __annotations__ = start_job.setting_properties(*settings_types)

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why no terrain can be frozen now, or an empty string."""
        return super().disabled_reason(context) or ("" if context.scene.camera is not None else "The scene needs an active camera")

    def prepare(self, context: bpy.types.Context) -> FreezePathJob:
        """Read the settings and the frames."""
        terrain, settings = self.active_terrain(context), self.read_settings(context)
        check_removal(terrain, settings[FreezeSettings])
        _ = terrain.origin  # raises SettingsError before the frame changes
        frames = choose_frames(context.scene, settings[FreezePathSettings])
        return FreezePathJob(terrain, terrain.folder, terrain.settings, settings[FreezeSettings], frames)


def check_removal(terrain: SceneTerrain, settings: FreezeSettings) -> None:
    """Raise SettingsError if a terrain cannot be removed although it is not to be kept."""
    if terrain.read_only_reason and not settings.keep_terrain:
        raise SettingsError(f"{terrain.read_only_reason}, or enable Keep Terrain.", ("keep_terrain",))


def choose_frames(scene: bpy.types.Scene, settings: FreezePathSettings) -> list[int]:
    """Return the frames of a camera path, with the first and the last one.

    Raises:
        SettingsError: there are none.
    """
    first, last = settings.first_frame, settings.last_frame
    if settings.scene_frame_range:
        uses_preview = scene.use_preview_range
        first, last = (scene.frame_preview_start, scene.frame_preview_end) if uses_preview else (scene.frame_start, scene.frame_end)
    if last < first:
        raise SettingsError(f"Last Frame, {last}, is before First Frame, {first}; raise it.", ("last_frame",))
    frames = list(range(first, last + 1, settings.frame_step))
    return frames if frames[-1] == last else [*frames, last]


class FARFIELD_PG_bdam_freeze(bpy.types.PropertyGroup):
    """Settings of *Freeze* and *Freeze Camera Path* in the panel, stored per scene."""

    __annotations__ = properties.build_annotations(FreezeSettings, set()) | properties.build_annotations(FreezePathSettings, set())


CLASSES = (FARFIELD_PG_bdam_freeze, FARFIELD_OT_bdam_freeze, FARFIELD_OT_bdam_freeze_path)
register, unregister = properties.scene_settings_factory("farfield_bdam_freeze", FARFIELD_PG_bdam_freeze, CLASSES)
