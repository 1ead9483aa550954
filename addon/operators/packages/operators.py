"""Operator and job of the tool `packages`: write objects as packages, which a web page loads within a time limit."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import bpy

from ...bridge.packages.sources import PackageSource, read_package_source
from ...bridge.scene_paths import check_scene_outputs
from ...core.files.filenames import safe_filename, unique_filenames
from ...core.files.outputs import Output
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.messages import join_sentences
from ...core.packages.files import check_package_folder, write_package
from ...core.packages.package import PackageReport, build_package
from ...core.packages.settings import FIXED_LEVEL_SETTINGS, PackageSettings
from ...core.texmesh.settings import TexmeshSettings
from .. import properties, start_job
from ..file_browser import find_start_folder, propose_folder, remember_folder
from ..properties import absolute_path
from ..texmesh.job import describe_skipped
from ..texmesh.operators import disabled_reason
from ..texmesh.sources import check_sizes, describe_small, read_sources, source_objects

FOLDER = {
    "name": "Folder",
    "description": "Folder for the package; files of an earlier one in it are replaced. By default, a new one "
    "called like the object, next to the .blend file or to the package before",
    "subtype": "DIR_PATH",
}


@dataclass
class PackageJob:
    """Builds packages and writes them. In the scene, it only keeps the folder of the first one.

    Attributes:
        sources: the objects.
        settings: of the levels.
        package_settings: of the packages.
        folders: of the packages, by object.
        skipped: names of other objects with the reason.
        reports: about the packages that are written.
    """

    core_fraction = 0.999

    sources: Sequence[PackageSource]
    settings: TexmeshSettings
    package_settings: PackageSettings
    folders: Sequence[Path]
    skipped: list[str]
    reports: list[PackageReport] = field(default_factory=list)

    def core_steps(self) -> Steps[list[PackageReport]]:
        """Build and write the package of each object."""
        count = len(self.sources)
        for index, (source, folder) in enumerate(zip(self.sources, self.folders, strict=True)):
            steps = build_package(source.name, source.mesh, source.materials, source.textures, self.settings, self.package_settings)
            package = yield from subprogress(steps, index / count, (index + 1) / count)
            write_package(package.manifest, package.contents, folder)
            self.reports.append(package.report)
        return self.reports

    def scene_steps(self, core_result: list[PackageReport]) -> Steps[str]:
        """Return the message for the user."""
        yield Progress(1.0, "Exported")
        folder = self.folders[0] if len(self.folders) == 1 else self.folders[0].parent
        bpy.context.scene.farfield_packages.exported = str(self.folders[0])
        sentences = [*(report.describe() for report in core_result), f'The folder is "{folder}".']
        sentences += [sentence for source in self.sources for sentence in (describe_small(source, self.settings), *source.remarks)]
        return join_sentences([*sentences, *describe_skipped(self.skipped)])


class FARFIELD_PG_packages(bpy.types.PropertyGroup):
    """Folder and settings of the panel *Packages*, stored per scene."""

    settings_types = (PackageSettings,)
    __annotations__ = properties.build_annotations(PackageSettings, set()) | {
        "folder": bpy.props.StringProperty(**FOLDER, options={"PATH_SUPPORTS_BLEND_RELATIVE"}),
        "exported": bpy.props.StringProperty(options={"HIDDEN"}),  # The folder of the package that was written last.
    }


class FARFIELD_OT_packages_export(start_job.StartJob, bpy.types.Operator):
    """Write the selected objects as packages of files for any web server, with a page that shows them within a time limit"""

    bl_idname = "farfield.packages_export"
    bl_label = "Export Package of Perceptual Levels"
    bl_options = {"REGISTER"}
    settings_types, panel_property = (TexmeshSettings,), "farfield_texmesh"
    disabled_reason = staticmethod(disabled_reason)
    __annotations__ = {
        **{name: item for name, item in start_job.setting_properties(*settings_types).items() if name not in FIXED_LEVEL_SETTINGS},
        **start_job.setting_properties(PackageSettings),
        "folder": bpy.props.StringProperty(**FOLDER, options={"SKIP_SAVE", "PATH_SUPPORTS_BLEND_RELATIVE"}),
    }

    def prepare(self, context: bpy.types.Context) -> PackageJob:
        """Read the selected objects."""
        settings = self.read_settings(context)[TexmeshSettings]
        panel = context.scene.farfield_packages
        properties.fill_unset(PackageSettings, self, panel)
        package_settings = properties.read(PackageSettings, self)
        folder = self.folder or panel.folder
        path = absolute_path(folder) if folder else default_folder(context)
        job = prepare_packages(context, source_objects(context), settings, package_settings, path)
        check_scene_outputs([Output("the folder of a package", path, check_package_folder, is_folder=True) for path in job.folders])
        remember_folder(self, context, path)
        return job


def default_folder(context: bpy.types.Context) -> Path:
    """Return the folder that a package gets if none is chosen. It does not exist yet."""
    objects = source_objects(context)
    name = safe_filename(f"{objects[0].name} package") if len(objects) == 1 else "packages"
    return propose_folder(find_start_folder(FARFIELD_OT_packages_export.__name__, context) / name)


def prepare_packages(
    context: bpy.types.Context,
    objects: Sequence[bpy.types.Object],
    settings: TexmeshSettings,
    package_settings: PackageSettings,
    folder: Path,
) -> PackageJob:
    """Return the job that writes packages of `objects` into `folder`, several into a folder for each. Raises FarfieldError if none can be
    read."""
    sources, skipped = read_sources(context, objects, read_package_source)
    check_sizes(sources)
    names = unique_filenames([source.name for source in sources])
    folders = [folder / name for name in names] if len(names) > 1 else [folder]
    return PackageJob(sources, replace(settings, **FIXED_LEVEL_SETTINGS), package_settings, folders, skipped)


CLASSES = (FARFIELD_PG_packages, FARFIELD_OT_packages_export)
register, unregister = properties.scene_settings_factory("farfield_packages", FARFIELD_PG_packages, CLASSES)
