"""Operators of the tool `bdam` that build a terrain: choose its files, then build it in the background."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ...bridge.imaging.images import read_gray_image
from ...bridge.scene_paths import check_scene_outputs
from ...core.bdam.building.store_target import check_target
from ...core.bdam.building.terrain_build import BuildReport, build_terrain
from ...core.bdam.fields.terrain_field import FieldSettings, TerrainField, open_field, warn_of_heights
from ...core.bdam.settings import BdamSettings
from ...core.errors import SettingsError
from ...core.files.outputs import Input, Output
from ...core.files.scratch import Scratch
from ...core.heights.readers import OPENERS
from ...core.jobs.progress import Progress, Steps
from .. import long_work, properties, start_job
from ..error_reports import reports_errors
from ..properties import BLEND_PREFIX, absolute_path

MAX_KEPT_BYTES = 64 << 20  # bytes of images of heights that stay in memory
KINDS = [
    ("SOURCES", "Elevation Models", "Files with heights: GeoTIFF, .hgt, .asc, .npy or images"),
    ("IMAGES", "Images", "Images of the ground: GeoTIFF, JPEG, PNG or WebP"),
]
FILTERS = {
    "SOURCES": ";".join(f"*{extension}" for extension in OPENERS),
    "IMAGES": "*.tif;*.tiff;*.jpg;*.jpeg;*.png;*.webp",
}
STORE = {"name": "Store", "description": "Folder for the terrain; it is created, or a terrain in it is replaced", "subtype": "DIR_PATH"}


class FARFIELD_PG_bdam_file(bpy.types.PropertyGroup):
    """A file of a build. Its name is the path, because operators can only be given lists of items with names."""

    __annotations__ = {"name": bpy.props.StringProperty(name="File", subtype="FILE_PATH", options={"PATH_SUPPORTS_BLEND_RELATIVE"})}


def _file_properties(options: set[str]) -> dict[str, Any]:
    """Return the properties of the files of a build, as annotations."""
    return {
        "sources": bpy.props.CollectionProperty(name="Sources", type=FARFIELD_PG_bdam_file, options=options),
        "images": bpy.props.CollectionProperty(name="Images", type=FARFIELD_PG_bdam_file, options=options),
        "store": bpy.props.StringProperty(**STORE, options=options | {"PATH_SUPPORTS_BLEND_RELATIVE"}),
    }


class FARFIELD_PG_bdam_build(bpy.types.PropertyGroup):
    """Files and settings of the next build, stored per scene."""

    settings_types = (BdamSettings,)
    __annotations__ = properties.build_annotations(BdamSettings, set()) | _file_properties(set())

    def files(self, kind: str) -> bpy.types.bpy_prop_collection:
        """Return the elevation models or the images."""
        return self.sources if kind == "SOURCES" else self.images


class FARFIELD_OT_bdam_add_files(bpy.types.Operator):
    """Add files to the next build of a terrain"""

    bl_idname = "farfield.bdam_add_files"
    bl_label = "Add Files of Large Terrain"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = {
        "kind": bpy.props.EnumProperty(name="Kind", items=KINDS, options={"SKIP_SAVE"}),
        "directory": bpy.props.StringProperty(name="Folder", subtype="DIR_PATH"),
        "files": bpy.props.CollectionProperty(name="Files", type=bpy.types.OperatorFileListElement, options={"SKIP_SAVE", "HIDDEN"}),
        "filter_glob": bpy.props.StringProperty(default="", options={"HIDDEN", "SKIP_SAVE"}),
    }

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser."""
        self.filter_glob = FILTERS[self.kind]
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add the chosen files that are not in the list."""
        files = context.scene.farfield_bdam_build.files(self.kind)
        for file in self.files:
            path = str(Path(self.directory) / file.name) if not self.directory.startswith(BLEND_PREFIX) else self.directory + file.name
            if file.name and path not in {item.name for item in files}:
                files.add().name = path
        return {"FINISHED"}


class FARFIELD_OT_bdam_remove_file(bpy.types.Operator):
    """Remove a file from the next build of a terrain. The file itself stays"""

    bl_idname = "farfield.bdam_remove_file"
    bl_label = "Remove File of Large Terrain"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = {
        "kind": bpy.props.EnumProperty(name="Kind", items=KINDS, options={"SKIP_SAVE"}),
        "index": bpy.props.IntProperty(name="Index", description="Position in the list; -1 for all files", default=-1, min=-1),
    }

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove the file, or all."""
        files = context.scene.farfield_bdam_build.files(self.kind)
        if self.index < 0:
            files.clear()
        else:
            files.remove(self.index)
        return {"FINISHED"}


@dataclass
class BuildJob:
    """Builds a terrain. It does not change the scene.

    Attributes:
        field: the elevation models.
        sources, images: their files, and those of images of the ground.
        store: the folder to write.
        settings: settings of the build.
        scratch: images of heights that Blender has decoded.
    """

    core_fraction = 0.999

    field: TerrainField
    sources: Sequence[Path]
    images: Sequence[Path]
    store: Path
    settings: BdamSettings
    scratch: Scratch

    def core_steps(self) -> Steps[BuildReport]:
        """Build the terrain."""
        with self.scratch:
            yield Progress(0.0, "Checking heights")
            field = warn_of_heights(self.field)
            return (yield from build_terrain(field, self.sources, self.store, self.settings, self.images))

    def scene_steps(self, core_result: BuildReport) -> Steps[str]:
        """Return the message for the user."""
        yield Progress(1.0, "Built")
        size = f"{core_result.columns:,} by {core_result.rows:,} heights"
        message = f'"{self.store.name}": {size} in {core_result.patches:,} patches, {core_result.bytes / 1e6:,.1f} MB.'
        return " ".join([message, *core_result.warnings])


class FARFIELD_OT_bdam_build(start_job.StartJob, bpy.types.Operator):
    """Build a terrain from elevation models and images in a folder, which can be loaded then. A build that was cancelled continues where it
    was if it is started again"""

    bl_idname = "farfield.bdam_build"
    bl_label = "Build Large Terrain"
    bl_options = {"REGISTER"}
    settings_types, panel_property = (BdamSettings,), "farfield_bdam_build"
    __annotations__ = start_job.setting_properties(*settings_types) | _file_properties({"SKIP_SAVE"})

    @classmethod
    def disabled_reason(cls, _context: bpy.types.Context) -> str:
        """Return why no terrain can be built now, or an empty string."""
        return long_work.running_job_message()

    def prepare(self, context: bpy.types.Context) -> BuildJob:
        """Open the elevation models; read those that only Blender can read."""
        settings = self.read_settings(context)[BdamSettings]
        panel = context.scene.farfield_bdam_build
        is_given = self.properties.is_property_set
        sources = _read_paths(self.sources if is_given("sources") else panel.sources)
        images = _read_paths(self.images if is_given("images") or is_given("sources") else panel.images)
        folder = self.store if is_given("store") else panel.store
        if not folder:
            raise SettingsError("The terrain needs a folder; set Store.", ("store",))
        store = absolute_path(folder)
        inputs = [Input(f'"{path.name}"', path) for path in (*sources, *images)]
        check_scene_outputs([Output("Store", store, check_target, is_folder=True)], inputs)
        scratch = Scratch(MAX_KEPT_BYTES)
        field_settings = FieldSettings(settings.cell_size, settings.image_height, settings.allow_gaps)
        field = open_field(sources, field_settings, lambda path: scratch.keep(read_gray_image(path), 0))
        return BuildJob(field, sources, images, store, settings, scratch)


def _read_paths(files: bpy.types.bpy_prop_collection) -> list[Path]:
    """Return the absolute paths of a list of files."""
    return [absolute_path(file.name) for file in files]


CLASSES = (
    FARFIELD_PG_bdam_file,
    FARFIELD_PG_bdam_build,
    FARFIELD_OT_bdam_add_files,
    FARFIELD_OT_bdam_remove_file,
    FARFIELD_OT_bdam_build,
)
register, unregister = properties.scene_settings_factory("farfield_bdam_build", FARFIELD_PG_bdam_build, CLASSES)
