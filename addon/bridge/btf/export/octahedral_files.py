"""Octahedral atlases as files for other programs: one PNG per map, and a JSON file with the layout."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ....core.btf.octahedral import FrameGrid, OctahedralAtlas
from ....core.errors import FileError
from ....core.files.atomic_write import atomic_folder
from ....core.geometry.mesh import check_points
from ....core.jobs.progress import Steps
from ...geometry.meshes import read_source
from ...imaging.images import create_image
from ...objects import temporarily_visible
from .octahedral_capture import capture_atlas

METADATA_FILE = "octahedral_atlas.json"
IMAGE_NAMES = {"color": "Color", "normal_height": "Normal and Height", "roughness_metallic": "Roughness and Metallic"}
MAP_CHANNELS = {
    "color": {"rgb": "base color, sRGB, straight alpha", "a": "coverage"},
    "normal_height": {
        "rgb": "mean world-space normal facing the viewer, -1..1 encoded as 0..1; shorter than 1 if the normals of a texel differ",
        "a": "height above the plane through the center that faces the viewer, -half_side..half_side encoded as 0..1",
    },
    "roughness_metallic": {"r": "roughness", "g": "metallic"},
}


def write_octahedral_atlas(
    objects: Sequence[bpy.types.Object],
    folder: Path,
    frames_per_side: int = 12,
    frame_resolution: int = 128,
    upper: bool = False,
    samples: int = 32,
) -> Steps[list[Path]]:
    """Capture `objects` in frames_per_side x frames_per_side frames and write them into `folder`.

    Files: color.png, normal_height.png, roughness_metallic.png if one of both varies, and octahedral_atlas.json. Returns their paths. They
    are written after the last render.

    upper: only directions above the horizon, on a hemi-octahedral grid.

    Raises:
        FileError: if the folder cannot be written; and as `capture_atlas`.
        GeometryError: if no object has a face, or vertices of faces are not finite.
        SettingsError: if `frames_per_side` is out of range.
    """
    grid = FrameGrid(frames_per_side, upper)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f'The folder "{folder}" cannot be created ({error.strerror}); choose another one.') from error
    with temporarily_visible(bpy.context, objects) as depsgraph:
        source = read_source(list(objects), depsgraph)
    check_points(source.mesh.vertices[np.unique(source.mesh.triangles)], source.name)
    atlas = yield from capture_atlas(source, grid, frame_resolution, samples)
    images = create_atlas_images(source.name, atlas)
    try:
        contents = {f"{key}.png": bytes(image.packed_file.data) for key, image in images.items()}
    finally:
        bpy.data.batch_remove(list(images.values()))
    contents[METADATA_FILE] = json.dumps(build_metadata(atlas, list(images)), indent=1).encode()
    with atomic_folder(folder) as temporary:
        for name, content in contents.items():
            (temporary / name).write_bytes(content)
    return [folder / name for name in contents]


def create_atlas_images(name: str, atlas: OctahedralAtlas) -> dict[str, bpy.types.Image]:
    """Create the maps of `atlas` as packed images with 8 bits per channel, by their keys in `OctahedralAtlas.encode`."""
    return {key: create_image(f"{name} {IMAGE_NAMES[key]}", pixels, is_data=key != "color") for key, pixels in atlas.encode().items()}


def build_metadata(atlas: OctahedralAtlas, maps: Sequence[str]) -> dict[str, Any]:
    """Return the layout of an atlas with these `maps` as plain values for JSON."""
    roughness_metallic = atlas.uniform_roughness_metallic
    frames = []
    for index in range(len(atlas.grid)):
        view, (row, column) = atlas.view(index), divmod(index, atlas.grid.frames_per_side)
        axes = {"direction": view.direction, "right": view.right, "up": view.up}
        frames.append({"row": row, "column": column, **{key: [round(float(value), 9) for value in axis] for key, axis in axes.items()}})
    return {
        "format": "farfield-octahedral-atlas",
        "version": 1,
        "map": "hemi-octahedral" if atlas.grid.upper else "octahedral",
        "frames_per_side": atlas.grid.frames_per_side,
        "frame_resolution": atlas.frame_resolution,
        "origin": "row 0 is at the bottom of the image, column 0 at the left; frames are orthographic, `direction` points to the viewer",
        "space": "Blender world: right-handed, Z up",
        "center": [float(value) for value in atlas.center],
        "half_side": float(atlas.half_side),
        "maps": {key: {"file": f"{key}.png", **MAP_CHANNELS[key]} for key in maps},
        "roughness": None if roughness_metallic is None else float(roughness_metallic[0]),
        "metallic": None if roughness_metallic is None else float(roughness_metallic[1]),
        "frames": frames,
    }
