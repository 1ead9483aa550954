"""Operators of the tool `bdam` that build a terrain: choose its files, then build it in the background."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy

from ...bridge.imaging.images import read_gray_image
from ...bridge.scene_paths import check_scene_outputs
from ...core.bdam.building.store_target import check_target
from ...core.bdam.building.terrain_build import BuildReport, build_terrain
from ...core.bdam.fields.terrain_field import FieldSettings, TerrainField, open_field, warn_of_heights
from ...core.bdam.settings import BdamSettings, ViewSettings
from ...core.errors import SettingsError
from ...core.files.outputs import Input, Output
from ...core.files.scratch import Scratch
from ...core.heights.readers import OPENERS
from ...core.jobs.progress import Progress, Steps
from ...core.messages import join_sentences
from .. import long_work, properties, start_job
from ..error_reports import reports_errors
from ..file_browser import open_file_browser, propose_folder, remember_folder
from ..job_run import run_job
from ..properties import BLEND_PREFIX, absolute_path
from ..view_following import find_viewport, viewport_address
from .job import prepare_load

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
    bl_label = "Add Terrain Files"
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
        return open_file_browser(self, context)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add the chosen files that are not in the list, and propose a folder for the terrain."""
        remember_folder(self, context, Path(bpy.path.abspath(self.directory), "file"))
        files = context.scene.farfield_bdam_build.files(self.kind)
        for file in self.files:
            path = str(Path(self.directory) / file.name) if not self.directory.startswith(BLEND_PREFIX) else self.directory + file.name
            if file.name and path not in {item.name for item in files}:
                files.add().name = path
        panel = context.scene.farfield_bdam_build
        if self.kind == "SOURCES" and len(files) and not panel.store:
            panel.store = propose_store(files[0].name)
        return {"FINISHED"}


def propose_store(path: str) -> str:
    """Return a folder next to the file of an elevation model that does not exist yet."""
    base = f"{path.rpartition('.')[0]} terrain"
    return base + propose_folder(Path(bpy.path.abspath(base))).name.removeprefix(Path(base).name)


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
    """Builds a terrain, and shows it in the scene if that is wanted.

    Attributes:
        heights: the elevation models.
        sources, images: their files, and those of images of the ground.
        store: the folder to write.
        settings: settings of the build.
        scratch: images of heights that Blender has decoded.
        directory: the store as the scene refers to it, empty if it is not shown.
        view_settings: how it is shown.
        area_address: of the 3D Viewport that shows all of it, see `find_viewport`.
    """

    core_fraction = 0.95

    heights: TerrainField
    sources: Sequence[Path]
    images: Sequence[Path]
    store: Path
    settings: BdamSettings
    scratch: Scratch
    directory: str = ""
    view_settings: ViewSettings = field(default_factory=ViewSettings)
    area_address: int = 0

    def core_steps(self) -> Steps[BuildReport]:
        """Build the terrain."""
        with self.scratch:
            yield Progress(0.0, "Checking heights")
            heights = warn_of_heights(self.heights)
            return (yield from build_terrain(heights, self.sources, self.store, self.settings, self.images))

    def scene_steps(self, core_result: BuildReport) -> Steps[str]:
        """Show the terrain. Returns the message for the user."""
        yield Progress(0.0, "Built")
        size = f"{core_result.columns:,} by {core_result.rows:,} heights"
        message = f'"{self.store.name}": {size} in {core_result.patches:,} patches, {core_result.bytes / 1e6:,.1f} MB.'
        sentences = [core_result.describe_voids()]  # The panel shows the first sentences: what the user has to know.
        if self.directory:
            scene, area = find_viewport(self.area_address)
            sentences.append((yield from run_job(prepare_load(scene, self.directory, self.view_settings, area))))
        return join_sentences([*sentences, message, *core_result.warnings])


class FARFIELD_OT_bdam_build(start_job.StartJob, bpy.types.Operator):
    """Build a terrain from elevation models and images in a folder, and load it. A build that was cancelled continues where it was if it is
    started again"""

    bl_idname = "farfield.bdam_build"
    bl_label = "Build Large Terrain"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (BdamSettings,), "farfield_bdam_build"
    __annotations__ = {
        **start_job.setting_properties(*settings_types),
        **_file_properties({"SKIP_SAVE"}),
        "load": bpy.props.BoolProperty(
            name="Load", description="Show the terrain in the scene, and all of it in the 3D Viewport", options={"SKIP_SAVE"}
        ),
    }

    @classmethod
    def disabled_reason(cls, _context: bpy.types.Context) -> str:
        """Return why no terrain can be built now, or an empty string."""
        return long_work.running_job_message()

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start the job in the background; the button of the panel also loads the terrain."""
        if not self.properties.is_property_set("load"):
            self.load = True
        return super().invoke(context, event)

    def prepare(self, context: bpy.types.Context) -> BuildJob:
        """Open the elevation models; read those that only Blender can read."""
        settings = self.read_settings(context)[BdamSettings]
        panel = context.scene.farfield_bdam_build
        is_given = self.properties.is_property_set
        sources = _read_paths(self.sources if is_given("sources") else panel.sources)
        images = _read_paths(self.images if is_given("images") or is_given("sources") else panel.images)
        folder = self.store if is_given("store") else panel.store
        if not sources:
            raise SettingsError("The terrain needs at least one elevation model; add files, and a folder for it is proposed.")
        if not folder:
            raise SettingsError("The terrain needs a folder; set Store.", ("store",))
        store = absolute_path(folder)
        inputs = [Input(f'"{path.name}"', path) for path in (*sources, *images)]
        check_scene_outputs([Output("Store", store, check_target, is_folder=True)], inputs)
        scratch = Scratch(MAX_KEPT_BYTES)
        field_settings = FieldSettings(settings.cell_size, settings.image_height, settings.allow_gaps)
        opened = open_field(sources, field_settings, lambda path: scratch.keep(read_gray_image(path), 0))
        view_settings, address = properties.read(ViewSettings, context.scene.farfield_bdam_view), viewport_address(context)
        directory = folder if self.load else ""
        return BuildJob(opened, sources, images, store, settings, scratch, directory, view_settings, address)


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
