"""An octahedral atlas as files for other programs: a PNG for every map, and a JSON that says what stands where."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy

from ..core.btf.octahedral import Atlas, FrameGrid
from ..core.errors import FileError
from ..core.progress import Steps
from .btf_octahedral import atlas_images
from .btf_octahedral_capture import capture_atlas
from .meshes import take

LAYOUT = "octahedral_atlas.json"
CHANNELS = {
    "colour": {"rgb": "base colour, sRGB, straight", "a": "coverage"},
    "normal_height": {
        "rgb": "mean world-space normal on the side of the viewer, 0..1 for -1..1; short where the surfaces of a texel differ",
        "a": "height above the plane through the centre that faces the viewer, 0..1 for -half_side..half_side",
    },
    "surface": {"r": "roughness", "g": "metallic"},
}


def write_octahedral_atlas(
    objects: Sequence[bpy.types.Object], folder: Path, frames: int = 12, resolution: int = 128, upper: bool = False, samples: int = 32
) -> Steps[list[Path]]:
    """Capture `objects` from frames x frames sides, `resolution` pixels each, and write `folder`: colour.png, normal_height.png, where
    roughness or metallic differ surface.png, and octahedral_atlas.json. Returns their paths; they are written when all renders are done.

    upper: sides above the horizon only, on a hemi-octahedral grid.

    Raises:
        FileError: when the folder cannot be written, or what `capture_atlas` raises.
        GeometryError: when no object has a face.
        SettingsError: when `frames` is out of range.
    """
    grid = FrameGrid(frames, upper)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f'The folder "{folder}" cannot be made ({error.strerror}); choose another one.') from error
    source = take(list(objects), bpy.context.evaluated_depsgraph_get())
    atlas = yield from capture_atlas(source, grid, resolution, samples)
    images = atlas_images(source.name, atlas)
    try:
        contents = {f"{key}.png": bytes(image.packed_file.data) for key, image in images.items()}
    finally:
        bpy.data.batch_remove(list(images.values()))
    contents[LAYOUT] = json.dumps(layout(atlas, list(images)), indent=1).encode()
    try:
        for name, content in contents.items():
            (folder / f".{name}.part").write_bytes(content)
        for name in contents:
            (folder / f".{name}.part").replace(folder / name)
    except OSError as error:
        for name in contents:
            (folder / f".{name}.part").unlink(missing_ok=True)
        raise FileError(f'"{folder}" cannot be written ({error.strerror}); free some space there or choose another folder.') from error
    return [folder / name for name in contents]


def layout(atlas: Atlas, maps: Sequence[str]) -> dict[str, Any]:
    """What a reader has to know about an atlas of these `maps`, as plain values for JSON."""
    surface = atlas.plain_surface
    pictures = []
    for number in range(len(atlas.grid)):
        view, (row, column) = atlas.view(number), divmod(number, atlas.grid.frames)
        axes = {"direction": view.direction, "right": view.right, "up": view.up}
        pictures.append({"row": row, "column": column, **{key: [round(float(value), 9) for value in axis] for key, axis in axes.items()}})
    return {
        "format": "farfield-octahedral-atlas",
        "version": 1,
        "map": "hemi-octahedral" if atlas.grid.upper else "octahedral",
        "frames": atlas.grid.frames,
        "frame_pixels": atlas.pixels,
        "origin": "row 0 is the lowest of the image, column 0 the leftmost; frames are orthographic, `direction` points to the viewer",
        "space": "Blender world: right-handed, Z up",
        "center": [float(value) for value in atlas.center],
        "half_side": float(atlas.half_side),
        "maps": {key: {"file": f"{key}.png", **CHANNELS[key]} for key in maps},
        "roughness": None if surface is None else float(surface[0]),
        "metallic": None if surface is None else float(surface[1]),
        "pictures": pictures,
    }
