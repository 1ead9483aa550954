"""The job behind the export button and the script: relightable textures in, files for other programs out."""

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..bridge.btf_clouds import texels_of_level
from ..bridge.btf_folders import write_folder
from ..bridge.btf_octahedral_exports import write_octahedral_atlas
from ..bridge.btf_reading import baked_atlas, is_upper
from ..bridge.exports import write_glb
from ..core.btf.decoding import BakedAtlas
from ..core.btf.fmf import write_fmf
from ..core.btf.settings import ExportSettings
from ..core.directions import bonn_directions
from ..core.errors import FileError, GeometryError
from ..core.progress import Progress, Steps, scaled
from ..core.whole import check_vacant, whole
from .billboards_clouds import cloud_for

GLB, FMF, OCTAHEDRAL, FOLDER = ".glb", ".btf", ".octahedral", ""
KINDS = {
    GLB: "quads, colours and normals",
    FMF: "a full matrix factorisation",
    OCTAHEDRAL: "a folder with an octahedral atlas of the original, 12 x 12 pictures a map",
    FOLDER: "a folder of pictures, one a view and light",
}


@dataclass(frozen=True)
class Part:
    """One level to be written. pixels_per_millimetre: of its texture, in a scene of metres."""

    name: str
    target: Path
    atlas: BakedAtlas
    pixels_per_millimetre: float


@dataclass
class BtfExportJob:
    """Writes the levels called `names` to `target`, whose ending says what it becomes; see `prepare`. sources: names of the original's
    objects; upper: whether it was baked from above the horizon alone."""

    core_share = 0.5

    names: list[str]
    target: Path
    settings: ExportSettings
    parts: list[Part]
    sources: list[str]
    upper: bool

    def core_steps(self) -> Steps[None]:
        """The files that need no Blender.

        Raises:
            FileError: when something cannot be written.
            SettingsError: when the kind of file cannot hold the bake's directions.
        """
        yield Progress(0.0, "Preparing")
        if self.target.suffix.lower() != FMF:
            return
        for number, part in enumerate(self.parts):
            with whole(part.target) as temporary, temporary.open("wb") as stream:
                steps = write_fmf(stream, part.atlas, *self._directions(part.atlas), part.pixels_per_millimetre)
                yield from scaled(steps, number / len(self.parts), (number + 1) / len(self.parts))

    def scene_steps(self, _core_result: None) -> Steps[str]:
        """The files that Blender writes; raises as `core_steps`."""
        yield Progress(0.0, f"Writing {self.target.name}")
        kind = self.target.suffix.lower()
        try:
            if kind == GLB:
                with whole(self.target) as temporary:
                    temporary.parent.mkdir(exist_ok=True)
                    write_glb([bpy.data.objects[name] for name in self.names], temporary)
            elif kind == OCTAHEDRAL:
                with whole(self.target) as temporary:
                    yield from write_octahedral_atlas([bpy.data.objects[name] for name in self.sources], temporary, upper=self.upper)
            elif kind == FOLDER:
                yield from self._write_folders()
        except RuntimeError as error:
            raise FileError(f'Cannot write "{self.target}": {str(error).strip().splitlines()[-1]}') from error
        return f'Wrote "{self.target.name}".'

    def _write_folders(self) -> Steps[None]:
        for number, part in enumerate(self.parts):
            with whole(part.target) as temporary:
                temporary.mkdir()
                steps = write_folder(part.atlas, temporary, *self._directions(part.atlas))
                yield from scaled(steps, number / len(self.parts), (number + 1) / len(self.parts))

    def _directions(self, atlas: BakedAtlas) -> tuple[np.ndarray, np.ndarray]:
        """Views and lights."""
        if self.settings.directions == "bonn":
            return bonn_directions(), bonn_directions()
        return atlas.views.directions, atlas.lights.directions


def prepare(levels: list[bpy.types.Object], target: Path, settings: ExportSettings) -> BtfExportJob:
    """The job that writes `levels`: a .glb holds them all; of the other kinds each gets its own, beside or within `target`.

    Raises:
        FileError: see `check_target`.
        GeometryError: when a level has no relightable textures, or for an octahedral atlas the original is gone.
    """
    check_target(target)
    kind = target.suffix.lower()
    atlases = [baked_atlas(level) for level in levels] if kind in {FMF, FOLDER} else []
    parts = []
    for level, atlas in zip(levels, atlases, strict=bool(atlases)):
        side = texels_of_level(level).side
        parts.append(Part(level.name, _own(target, level, len(levels)), atlas, 0.001 / side))
    sources = _originals(levels[0]) if kind == OCTAHEDRAL else []
    return BtfExportJob([level.name for level in levels], target, settings, parts, sources, kind == OCTAHEDRAL and is_upper(levels[0]))


def _originals(level: bpy.types.Object) -> list[str]:
    cloud = cloud_for(bpy.context.scene, level)
    if cloud is None or not cloud.sources or len(cloud.sources) < len(cloud.source_names):
        raise GeometryError(f'The original of "{level.name}" is gone, and an octahedral atlas is taken from it; bring it back.')
    return cloud.source_names


def check_target(target: Path) -> None:
    """Raise FileError when the ending of `target` is none of KINDS, or when a folder of that name holds something."""
    if target.suffix.lower() not in KINDS:
        endings = ", ".join(f"{ending} ({words})" if ending else f"no ending ({words})" for ending, words in KINDS.items())
        raise FileError(f'Relightable textures cannot be written as "{target.name}"; it must have one of these endings: {endings}.')
    check_vacant(target)


def _own(target: Path, level: bpy.types.Object, levels: int) -> Path:
    """Where one of several levels goes."""
    if levels == 1:
        return target
    name = level.name.replace(" ", "_")
    return target / name if target.suffix == FOLDER else target.with_name(f"{target.stem}_{name}{target.suffix}")
