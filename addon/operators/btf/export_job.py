"""The job of the export operator and script: writes relightable textures as files for other programs."""

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...bridge.billboards.exports import write_glb
from ...bridge.billboards.level_objects import read_level_texels
from ...bridge.billboards.scene_clouds import find_cloud
from ...bridge.btf.decode import is_upper_hemisphere, read_relightable_texture
from ...bridge.btf.image_export import write_images
from ...bridge.btf.octahedral.exports import write_octahedral_atlas
from ...core.btf.decoding import RelightableTexture
from ...core.btf.formats.fmf import write_fmf
from ...core.btf.settings import ExportSettings
from ...core.errors import FileError, GeometryError
from ...core.files.atomic_write import atomic_write, check_empty
from ...core.geometry.directions import bonn_directions
from ...core.jobs.progress import Progress, Steps, subprogress

GLB, FMF, OCTAHEDRAL_FOLDER, IMAGE_FOLDER = ".glb", ".btf", ".octahedral", ""
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

    level_names: of the level objects. source_names: of the source objects. upper_hemisphere: whether only directions above the horizon
    were baked.
    """

    core_fraction = 0.5

    level_names: list[str]
    target: Path
    settings: ExportSettings
    items: list[ExportItem]
    source_names: list[str]
    upper_hemisphere: bool

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
        """Write the formats that need Blender. Raises as `core_steps`."""
        yield Progress(0.0, f"Writing {self.target.name}")
        suffix = self.target.suffix.lower()
        try:
            if suffix == GLB:
                with atomic_write(self.target) as temporary:
                    temporary.parent.mkdir(exist_ok=True)
                    write_glb([bpy.data.objects[name] for name in self.level_names], temporary)
            elif suffix == OCTAHEDRAL_FOLDER:
                with atomic_write(self.target) as temporary:
                    sources = [bpy.data.objects[name] for name in self.source_names]
                    yield from write_octahedral_atlas(sources, temporary, upper=self.upper_hemisphere)
            elif suffix == IMAGE_FOLDER:
                yield from self._write_image_folders()
        except RuntimeError as error:
            raise FileError(f'Cannot write "{self.target}": {str(error).strip().splitlines()[-1]}') from error
        return f'Wrote "{self.target.name}".'

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
    """Prepare the export of `levels`. A .glb contains them all; other formats write one file or folder per level, beside or in `target`.

    Raises:
        FileError: see `check_target`.
        GeometryError: if a level has no relightable textures, or the source objects of an octahedral atlas are missing.
    """
    check_target(target)
    suffix = target.suffix.lower()
    textures = [read_relightable_texture(level) for level in levels] if suffix in {FMF, IMAGE_FOLDER} else []
    items = []
    for level, texture in zip(levels, textures, strict=bool(textures)):
        texel_size = read_level_texels(level).texel_size
        items.append(ExportItem(level.name, _level_target(target, level, len(levels)), texture, 0.001 / texel_size))
    is_octahedral = suffix == OCTAHEDRAL_FOLDER
    source_names = _existing_source_names(levels[0]) if is_octahedral else []
    level_names = [level.name for level in levels]
    return BtfExportJob(level_names, target, settings, items, source_names, is_octahedral and is_upper_hemisphere(levels[0]))


def _existing_source_names(level: bpy.types.Object) -> list[str]:
    cloud = find_cloud(bpy.context.scene, level)
    if cloud is None or not cloud.sources or len(cloud.sources) < len(cloud.source_names):
        raise GeometryError(f'Source objects of "{level.name}" are missing. An octahedral atlas is rendered from them; restore them.')
    return cloud.source_names


def check_target(target: Path) -> None:
    """Raise FileError if the suffix of `target` is not in FORMATS, or if it is a folder that is not empty."""
    if target.suffix.lower() not in FORMATS:
        suffixes = ", ".join(f"{suffix} ({text})" if suffix else f"no suffix ({text})" for suffix, text in FORMATS.items())
        raise FileError(f'Relightable textures cannot be written as "{target.name}"; it must have one of these suffixes: {suffixes}.')
    check_empty(target)


def _level_target(target: Path, level: bpy.types.Object, level_count: int) -> Path:
    """Return the target of one of `level_count` levels."""
    if level_count == 1:
        return target
    name = level.name.replace(" ", "_")
    return target / name if target.suffix == IMAGE_FOLDER else target.with_name(f"{target.stem}_{name}{target.suffix}")
