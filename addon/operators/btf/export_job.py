"""The job of the export operator and script: writes relightable textures as files for other programs."""

from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from ...bridge.billboards.exports import check_glb_levels, write_glb
from ...bridge.billboards.level_objects import read_level_texels
from ...bridge.billboards.scene_clouds import find_cloud
from ...bridge.blender import error_sentence
from ...bridge.btf.export.image_folders import write_images
from ...bridge.btf.export.octahedral_files import write_octahedral_atlas
from ...bridge.btf.levels.decode import is_upper_hemisphere, read_relightable_texture
from ...bridge.btf.levels.level_checks import check_quads
from ...bridge.objects import find_by_uid
from ...bridge.scene_paths import check_scene_outputs
from ...core.btf.decoding import RelightableTexture
from ...core.btf.formats.fmf import write_fmf
from ...core.btf.settings import ExportSettings
from ...core.errors import FileError, GeometryError
from ...core.files.atomic_write import atomic_write
from ...core.files.file_access import check_writable, check_writable_folder
from ...core.files.filenames import unique_filenames
from ...core.files.outputs import Output
from ...core.geometry.directions import bonn_directions
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.messages import join_sentences

GLB, FMF, OCTAHEDRAL_FOLDER, IMAGE_FOLDER = ".glb", ".btf", ".octahedral", ""
RADIANCE_SUFFIXES = (FMF, IMAGE_FOLDER)  # Need the model *emission*
FORMATS = {
    GLB: "quads, colors and normals",
    FMF: "full matrix factorization",
    OCTAHEDRAL_FOLDER: "folder with an octahedral atlas of the source, 12 x 12 frames per map",
    IMAGE_FOLDER: "folder of images, one per view and light",
}


@dataclass(frozen=True)
class ExportItem:
    """One level to write. pixels_per_millimeter: of its texture, in a scene in meters."""

    name: str
    target: Path
    texture: RelightableTexture
    pixels_per_millimeter: float


@dataclass
class BtfExportJob:
    """Writes levels to `target`, whose suffix selects the format; see `prepare_export`.

    Attributes:
        level_uids: Session UIDs of the level objects, since the user may rename them.
        target: File or folder.
        settings: Settings of the export.
        items: Levels with radiance, to write one by one.
        source_uids: Session UIDs of the source objects.
        upper_hemisphere: Whether only directions above the horizon were baked.
        remarks: Sentences about what the export lacks, once the job is finished.
    """

    core_fraction = 0.5

    level_uids: list[int]
    target: Path
    settings: ExportSettings
    items: list[ExportItem]
    source_uids: list[int]
    upper_hemisphere: bool
    remarks: list[str] = field(default_factory=list)

    def core_steps(self) -> Steps[None]:
        """Write the formats that do not need Blender.

        Raises:
            FileError: if a file cannot be written.
            SettingsError: if the format cannot store the baked directions.
        """
        yield Progress(0.0, "Preparing")
        if self.target.suffix.lower() != FMF:
            return
        for index, item in enumerate(self.items):
            with atomic_write(item.target) as temporary, temporary.open("wb") as stream:
                steps = write_fmf(stream, item.texture, *self._directions(item.texture), item.pixels_per_millimeter)
                yield from subprogress(steps, index / len(self.items), (index + 1) / len(self.items))

    def scene_steps(self, _core_result: None) -> Steps[str]:
        """Write the formats that need Blender. Raises as `core_steps`, and GeometryError if an object was removed."""
        yield Progress(0.0, f"Writing {self.target.name}")
        suffix = self.target.suffix.lower()
        try:
            if suffix == GLB:
                with atomic_write(self.target) as temporary:
                    temporary.parent.mkdir(exist_ok=True)
                    self.remarks += write_glb(_find_objects(self.level_uids), temporary)
            elif suffix == OCTAHEDRAL_FOLDER:
                with atomic_write(self.target) as temporary:
                    sources = _find_objects(self.source_uids)
                    yield from write_octahedral_atlas(sources, temporary, upper=self.upper_hemisphere)
            elif suffix == IMAGE_FOLDER:
                yield from self._write_image_folders()
        except RuntimeError as error:
            raise FileError(f'Cannot write "{self.target}": {error_sentence(error)}.') from error
        return join_sentences([f'Wrote "{self.target.name}".', *self.remarks])

    def _write_image_folders(self) -> Steps[None]:
        for index, item in enumerate(self.items):
            with atomic_write(item.target) as temporary:
                temporary.mkdir()
                steps = write_images(item.texture, temporary, *self._directions(item.texture))
                yield from subprogress(steps, index / len(self.items), (index + 1) / len(self.items))

    def _directions(self, texture: RelightableTexture) -> tuple[np.ndarray, np.ndarray]:
        """Return the view directions (V, 3) and light directions (L, 3) to write."""
        if self.settings.directions == "bonn":
            return bonn_directions(), bonn_directions()
        return texture.views.directions, texture.lights.directions


def prepare_export(levels: list[bpy.types.Object], target: Path, settings: ExportSettings) -> BtfExportJob:
    """Prepare the export of `levels`. A .glb contains them all; other formats write one file or folder per level, next to or in `target`.

    Raises:
        FileError: see `check_target`.
        GeometryError: if a level has no relightable textures; and see `check_levels`.
    """
    check_scene_outputs([Output("the export", target, check_target)])
    check_levels(levels, target)
    suffix = target.suffix.lower()
    textures = [read_relightable_texture(level) for level in levels] if suffix in RADIANCE_SUFFIXES else []
    items = []
    for level, path, texture in zip(levels, _level_targets(target, levels), textures, strict=False):
        items.append(ExportItem(level.name, path, texture, 0.001 / read_level_texels(level).texel_size))
    is_octahedral = suffix == OCTAHEDRAL_FOLDER
    sources = _existing_sources(levels[0]) if is_octahedral else []
    level_uids, source_uids = ([item.session_uid for item in objects] for objects in (levels, sources))
    return BtfExportJob(level_uids, target, settings, items, source_uids, is_octahedral and is_upper_hemisphere(levels[0]))


def check_levels(levels: list[bpy.types.Object], target: Path) -> None:
    """Check that `levels`, which need not be baked yet, can be exported to `target`.

    Raises:
        GeometryError: a level of a .glb was changed, or the source objects of an octahedral atlas are missing.
    """
    suffix = target.suffix.lower()
    if suffix == GLB:
        for level in levels:
            check_quads(level)
        check_glb_levels(levels)
    elif suffix == OCTAHEDRAL_FOLDER:
        _existing_sources(levels[0])


def _find_objects(session_uids: list[int]) -> list[bpy.types.Object]:
    """Return the objects with these session UIDs. Raises GeometryError if one was removed."""
    found = [find_by_uid(bpy.data.objects, uid) for uid in session_uids]
    if None in found:
        raise GeometryError("An object of the cloud was removed while it was being exported; export it again.")
    return found


def _existing_sources(level: bpy.types.Object) -> list[bpy.types.Object]:
    cloud = find_cloud(bpy.context.scene, level)
    sources = [] if cloud is None else cloud.sources
    if not sources or cloud.missing_source_names:
        raise GeometryError(f'Source objects of "{level.name}" are missing. An octahedral atlas is rendered from them; restore them.')
    return sources


def check_target(target: Path) -> None:
    """Raise FileError if the suffix of `target` is not in FORMATS, or if the file or folder cannot be written or is not empty."""
    if target.suffix.lower() not in FORMATS:
        suffixes = ", ".join(f"{suffix} ({text})" if suffix else f"no suffix ({text})" for suffix, text in FORMATS.items())
        raise FileError(f'Relightable textures cannot be written as "{target.name}"; it must have one of these suffixes: {suffixes}.')
    if target.suffix.lower() in (OCTAHEDRAL_FOLDER, IMAGE_FOLDER):
        check_writable_folder(target)
    else:
        check_writable(target)


def _level_targets(target: Path, levels: list[bpy.types.Object]) -> list[Path]:
    """Return the target of each level. Their names do not choose folders."""
    if len(levels) == 1:
        return [target]
    names = unique_filenames([level.name.replace(" ", "_") for level in levels])
    return [target / name if target.suffix == IMAGE_FOLDER else target.with_name(f"{target.stem}_{name}{target.suffix}") for name in names]
