"""Textured models for `texmesh_textures.py`: with textures of their own, photographs, and painted ones."""

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import photos_inputs
import photos_methods
import restore_textures
import texmesh_files
import texmesh_models
from PIL import Image

from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh

TUNING = ("spot", "bunny")
JUDGING = ("blub", "capsule", "fuze", "truck", "sceaux")  # and the generated ones
TEXTURE_FILES = {
    "spot": "textured/spot/spot_texture.png",
    "fuze": "hard_surface/fuze uv.jpg",
    "capsule": "hard_surface/capsule0.jpg",
}
PAINTED_SIDE = 2048
PAINTED_CELLS = 5  # per side of a painted texture, each with a texture of its own
SCEAUX_SIDE = 2048


class TexturedModel(NamedTuple):
    """A mesh, and the texture (H, W, 3) uint8 of each of its materials, row 0 at the bottom, None for those without."""

    mesh: TexturedMesh
    images: list[np.ndarray | None]


def open_textured(data: Path, name: str, seed: int) -> TexturedModel:
    """Return a model: one of TUNING and JUDGING, or KIND:SEED of texmesh_models. seed: of painted textures."""
    generator = np.random.default_rng(seed)
    if name == "sceaux":
        return build_sceaux(data)
    mesh = texmesh_models.open_model(data, name)
    if name in texmesh_models.REAL_MODELS:
        return TexturedModel(mesh, read_images(data, name, mesh))
    return TexturedModel(mesh, [paint_patches(generator) for _ in range(int(mesh.materials.max()) + 1)])


def read_images(data: Path, name: str, mesh: TexturedMesh) -> list[np.ndarray | None]:
    """Return the texture (H, W, 3) uint8 of each material of a real model, row 0 at the bottom, None for those without."""
    count = int(mesh.materials.max()) + 1
    if name in TEXTURE_FILES:
        return [read_image(data / TEXTURE_FILES[name])] * count
    return read_glb_images(data / texmesh_models.REAL_MODELS[name], count)


def read_image(source: Path | io.BytesIO) -> np.ndarray:
    """Return the pixels of an image."""
    with Image.open(source) as image:
        return np.asarray(image.convert("RGB"))[::-1].copy()


def read_glb_images(path: Path, count: int) -> list[np.ndarray | None]:
    """Return the base color textures of the materials of a .glb."""
    document, binary = texmesh_files.split_glb(path)
    images: list[np.ndarray | None] = []
    for material in document["materials"][:count]:
        texture = material.get("pbrMetallicRoughness", {}).get("baseColorTexture")
        if texture is None:
            images.append(None)
            continue
        view = document["bufferViews"][document["images"][document["textures"][texture["index"]]["source"]]["bufferView"]]
        start = view.get("byteOffset", 0)
        images.append(read_image(io.BytesIO(binary[start : start + view["byteLength"]])))
    return images


def build_sceaux(data: Path) -> TexturedModel:
    """Return the castle, textured from its photographs by the tool `photos`."""
    unwrapped = photos_inputs.unwrap_mesh(photos_inputs.read_mesh(data / "sceaux" / "mesh_15k.ply"))
    photographs = photos_inputs.load_photographs(data)
    textured = photos_methods.run_method("farfield", unwrapped.mesh, unwrapped.corner_uvs, photographs, SCEAUX_SIDE)
    image = np.rint(255.0 * np.clip(textured.colors[..., :3], 0.0, 1.0)).astype(np.uint8)
    mesh = replace(unwrapped.mesh, materials=np.zeros(len(unwrapped.mesh.triangles), np.int32))  # the file has no material
    return TexturedModel(build_textured_mesh(mesh, unwrapped.corner_uvs, name="sceaux"), [image])


def paint_patches(generator: np.random.Generator) -> np.ndarray:
    """Return a texture of squares with different materials, some calm and some busy."""
    side = PAINTED_SIDE // PAINTED_CELLS + 1
    kinds: list[Callable] = list(restore_textures.GENERATED.values())
    rows = [
        np.concatenate([kinds[generator.integers(len(kinds))](generator, (side, side)) for _ in range(PAINTED_CELLS)], axis=1)
        for _ in range(PAINTED_CELLS)
    ]
    image = np.concatenate(rows)[:PAINTED_SIDE, :PAINTED_SIDE]
    return np.rint(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)
