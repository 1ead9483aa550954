"""Textured models with their images, and levels of them with default settings, each made once for all parts of `bench_texmesh.py`."""

import io
import json
import struct
from argparse import Namespace
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import texmesh_models
from PIL import Image

from farfield.addon.core.errors import FileError
from farfield.addon.core.imaging.colors import decode_signed_srgb
from farfield.addon.core.imaging.mipmaps import Mipmaps, build_mipmaps, resize_by_area
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.level_chain import AllSettings, LevelChain, make_levels
from farfield.addon.core.texmesh.perception.settings import PerceptionSettings
from farfield.addon.core.texmesh.scale_space.settings import ScaleSpaceSettings
from farfield.addon.core.texmesh.settings import LevelSettings
from farfield.addon.core.texmesh.simplification.settings import SimplificationSettings
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

TEXTURE_FILES = {
    "spot": "textured/spot/spot_texture.png",
    "fuze": "hard_surface/fuze uv.jpg",
    "capsule": "hard_surface/capsule0.jpg",
}
PAINTED_SIDE = 512  # pixels of generated textures
BUNNY = "bunny"


@dataclass(frozen=True, eq=False)
class TexturedModel:
    """A mesh and an image (H, W, 3) float32 per material, linear; None for materials without one."""

    mesh: TexturedMesh
    textures: tuple[np.ndarray | None, ...]

    @property
    def mipmaps(self) -> list[Mipmaps | None]:
        """The mipmaps of all textures."""
        return [None if texture is None else build_mipmaps(texture) for texture in self.textures]


def default_settings() -> AllSettings:
    """Return the default settings."""
    return AllSettings(LevelSettings(), ScaleSpaceSettings(), SimplificationSettings(), PerceptionSettings())


def model_names(given: Namespace) -> list[str]:
    """Return the models that were asked for, or all, generated ones by the seed."""
    generated = [f"{kind}:{given.seed + index}" for index, kind in enumerate(texmesh_models.GENERATORS)]
    return given.models or [*texmesh_models.REAL_MODELS, BUNNY, *generated]


@cache
def open_textured(data: Path, name: str, seed: int) -> TexturedModel:
    """Return a model with its own images, or with images painted by `seed` if it has none."""
    mesh = texmesh_models.open_model(data, name)
    count = int(mesh.materials.max()) + 1
    if name in TEXTURE_FILES:
        return TexturedModel(mesh, (_decode((data / TEXTURE_FILES[name]).read_bytes()),) * count)
    if name in texmesh_models.REAL_MODELS:
        return TexturedModel(mesh, tuple(read_glb_textures(data / texmesh_models.REAL_MODELS[name])[:count]))
    generator = np.random.default_rng(seed)
    return TexturedModel(mesh, tuple(paint(PAINTED_SIDE, generator) for _ in range(count)))


@cache
def make_chain(data: Path, name: str, seed: int) -> LevelChain:
    """Return the levels of a model with default settings."""
    model = open_textured(data, name, seed)
    return run_to_end(make_levels(model.mesh, model.textures, default_settings(), name))


def read_glb_textures(path: Path) -> list[np.ndarray | None]:
    """Return the base color image of each material of a .glb, None where it has none.

    Raises:
        FileError: an image is not inside of the file.
    """
    content = path.read_bytes()
    length = struct.unpack_from("<I", content, 12)[0]
    document, binary = json.loads(content[20 : 20 + length]), content[20 + length + 8 :]
    images: list[np.ndarray | None] = []
    for material in document.get("materials", []):
        texture = material.get("pbrMetallicRoughness", {}).get("baseColorTexture")
        if texture is None:
            images.append(None)
            continue
        texture_index = texture["index"]
        image = document["images"][document["textures"][texture_index]["source"]]
        if "bufferView" not in image:
            raise FileError(f'"{path}" has images in other files; use one with all images inside.')
        view = document["bufferViews"][image["bufferView"]]
        start = view.get("byteOffset", 0)
        images.append(_decode(binary[start : start + view["byteLength"]]))
    return images


def _decode(content: bytes) -> np.ndarray:
    """Return the linear colors (H, W, 3) float32 of an image file, row 0 at the bottom."""
    with Image.open(io.BytesIO(content)) as image:
        encoded = np.asarray(image.convert("RGB"))[::-1].astype(np.float32) / np.float32(255.0)
    return decode_signed_srgb(encoded).astype(np.float32)


def paint(side: int, generator: np.random.Generator) -> np.ndarray:
    """Return an image (side, side, 3) of soft spots of several sizes in two colors, linear."""
    total = np.zeros((side, side), np.float32)
    for cells in (8, 32, 128):
        coarse = generator.random((cells, cells, 1)).astype(np.float32)
        total += resize_by_area(np.repeat(np.repeat(coarse, side // cells, axis=0), side // cells, axis=1), side)[..., 0] / 3.0
    colors = generator.uniform(0.05, 0.9, (2, 3)).astype(np.float32)
    weights = np.clip(3.0 * total - 1.0, 0.0, 1.0)[..., None]
    return colors[0] + weights * (colors[1] - colors[0])
