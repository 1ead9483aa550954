"""Operator of the tool `photos` that imports the cameras of other programs."""

from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np

from ...bridge.photos.camera_objects import create_cameras, import_mesh, set_render_size
from ...bridge.photos.photo_files import size_reader
from ...bridge.photos.photo_folders import PhotoFolder
from ...bridge.photos.photo_images import is_missing
from ...bridge.photos.scene_cameras import find_background
from ...core.errors import FarfieldError, FileError
from ...core.files.far_meshes import EXTENSIONS as MESH_EXTENSIONS
from ...core.files.file_access import check_unicode, convert_os_errors
from ...core.geometry.local_origin import describe_move, find_local_origin
from ...core.jobs.progress import run_to_end
from ...core.messages import format_count
from ...core.photos.importers import read_camera_file
from .. import long_work
from ..error_reports import report_message, reports_errors
from ..file_browser import open_file_browser, remember_folder
from ..job_run import run_job
from .previews import FARFIELD_OT_photos_draw_overlays, OverlayJob
from .sources import open_photographs, read_targets, selected_meshes

COLLECTION_NAME = "Photo Cameras"
ORIGIN_PROPERTY = "farfield_origin"  # custom property of the Empty: the position in the file that is at its origin
IMAGES_FOLDER = "images"  # searched for next to the cameras and in the two folders above
MODEL_FILES = {"cameras", "images", "points3D", "frames", "rigs"}  # files of COLMAP with these extensions, whose folder is read
MODEL_EXTENSIONS = {".txt", ".bin"}
CAMERA_FILES = (  # What to choose, in the file browser.
    ("COLMAP", "its folder, or any file"),
    ("NeRF", "transforms.json"),
    ("Metashape", ".xml"),
    ("Meshroom", ".sfm"),
    ("Bundler", ".out"),
    ("VisualSFM", ".nvm"),
    ("OpenMVS", ".mvs"),
    ("Pairs of points", ".pairs"),
)
FILTER = "*.txt;*.bin;*.json;*.sfm;*.out;*.nvm;*.mvs;*.xml;*.pairs"


class FARFIELD_OT_photos_import_cameras(bpy.types.Operator):
    """Import registered cameras with their photographs as background images: choose the folder of a COLMAP model, or any of its files, a
    transforms.json, or the camera file of Metashape, Meshroom, Bundler, VisualSFM or OpenMVS"""

    bl_idname = "farfield.photos_import_cameras"
    bl_label = "Import Photo Cameras"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = {
        "filepath": bpy.props.StringProperty(
            name="File", description="The folder of a COLMAP model or any of its files, or another camera file", subtype="FILE_PATH"
        ),
        "filter_glob": bpy.props.StringProperty(default=FILTER, options={"HIDDEN"}),
        "images": bpy.props.StringProperty(
            name="Images",
            description="Folder of the photographs. By default the folder images next to the cameras or above them",
            subtype="DIR_PATH",
            options={"SKIP_SAVE"},
        ),
        "mesh": bpy.props.StringProperty(
            name="Mesh",
            description="An .obj or .ply file in the coordinates of the cameras, to import it with them. Where these are too large for "
            "single precision, such as those of maps, both are moved to the origin",
            subtype="FILE_PATH",
            options={"SKIP_SAVE"},
        ),
        "y_up": bpy.props.BoolProperty(
            name="Y Up", description="Turn the cameras like Blender turns the meshes of .obj and .glb files, so that their y axis points up"
        ),
        "set_render_size": bpy.props.BoolProperty(
            name="Set Render Size", description="Set the resolution of the scene to the size of the first photograph"
        ),
        "draw_overlays": bpy.props.BoolProperty(
            name="Draw Overlays",
            description="If a mesh is selected, draw it into a copy of each photograph, to see whether cameras and mesh fit to each other",
            default=True,
        ),
    }

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser."""
        return open_file_browser(self, context)

    def draw(self, context: bpy.types.Context) -> None:
        """Say in the file browser what to choose, and draw the properties."""
        column = self.layout.column(align=True)
        for index, (program, files) in enumerate(CAMERA_FILES):
            column.label(text=f"{program}: {files}", icon="BLANK1" if index else "INFO")
        settings = self.layout.column()
        settings.use_property_split = True
        for name in ("images", "mesh", "y_up", "set_render_size", "draw_overlays"):
            settings.prop(self, name)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Read the cameras and create objects for them."""
        path = _absolute(self.filepath)
        remember_folder(self, context, path)
        mesh = _absolute(self.mesh) if self.mesh else None
        if mesh is not None and mesh.suffix.lower() not in MESH_EXTENSIONS:
            raise FileError(f'The mesh "{mesh.name}" is none of {" ".join(MESH_EXTENSIONS)}; convert it, or import it with Blender.')
        with convert_os_errors(f'Cannot read "{path}"'):
            folder = _absolute(self.images) if self.images else find_images(path if path.is_dir() else path.parent)
            is_model = path.stem in MODEL_FILES and path.suffix.lower() in MODEL_EXTENSIONS and path.is_file()
        found = read_camera_file(path.parent if is_model else path, size_reader(PhotoFolder(folder)))
        if mesh is None:
            origin = find_local_origin(np.array([camera.position for camera in found.cameras]))
        else:
            origin = import_mesh(mesh, is_y_up=self.y_up)
        cameras = found.cameras if origin is None else [camera.relative_to(origin) for camera in found.cameras]
        if self.set_render_size:
            set_render_size(context.scene, cameras[0].lens.size)
        parent, missing = create_cameras(cameras, folder, COLLECTION_NAME, context.scene, is_y_up=self.y_up)
        if context.scene.camera is None:
            context.scene.camera = parent.children[0]
        message, level = " ".join([f"Imported {format_count(len(cameras), 'camera')}.", *found.notes]), "WARNING" if found.notes else "INFO"
        if origin is not None:
            parent[ORIGIN_PROPERTY] = origin.tolist()
            message += f" {describe_move(origin, 'Cameras' if mesh is None else 'Mesh and cameras')}"
        if origin is not None and mesh is None:
            message, level = f"{message} Choose the file of the mesh as Mesh, too, or move the mesh alike.", "WARNING"
        if missing:
            message, level = f'{message} {format_count(missing, "photograph")} not found in "{folder}".', "WARNING"
        if self.draw_overlays:
            try:
                message += _draw_overlays(context, parent.children)
            except FarfieldError as error:  # the cameras are there
                message, level = f"{message} Overlays were not drawn: {error}", "WARNING"
        report_message(self, message, level)
        return {"FINISHED"}


def _draw_overlays(context: bpy.types.Context, cameras: Sequence[bpy.types.Object]) -> str:
    """Draw overlays of `cameras` if a mesh is selected, in the background if there is a window. Returns a message, empty without a mesh.
    Raises FarfieldError if an overlay cannot be drawn."""
    usable = [item for item in cameras if not is_missing(find_background(item.data).image)]
    if not usable or not selected_meshes(context) or context.mode != "OBJECT":
        return ""
    context.view_layer.update()
    _, instances, _ = read_targets(context)
    job = OverlayJob(instances, open_photographs(context, usable))
    if bpy.app.background or context.window is None:
        return f" {run_to_end(run_job(job))}"
    if long_work.running_job_message():
        return f" Overlays were not drawn: {long_work.running_job_message()}."
    cancel_message = "Cancelled; no overlay was drawn. The imported cameras stay."
    long_work.start_in_background(job, FARFIELD_OT_photos_draw_overlays.bl_label, "photos", cancel_message=cancel_message)
    return " Overlays are being drawn; open them in the Image Editor."


def find_images(folder: Path) -> Path:
    """Return the folder of the photographs for cameras in `folder`: `images` in it or in one of the two above, otherwise `folder`."""
    candidates = (parent / IMAGES_FOLDER for parent in (folder, *folder.parents[:2]))
    return next((candidate for candidate in candidates if candidate.is_dir()), folder)


def _absolute(text: str) -> Path:
    """Return the path that a user has entered. Raises FileError."""
    if not text:
        raise FileError("No file is chosen; choose a file or folder with cameras.")
    path = Path(bpy.path.abspath(text))
    check_unicode(path)
    return path.absolute()


register, unregister = bpy.utils.register_classes_factory((FARFIELD_OT_photos_import_cameras,))
