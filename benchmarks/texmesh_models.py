"""Textured meshes for `bench_texmesh.py`: real ones, a painted bunny, and generated ones with many UV islands."""

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

from farfield.addon.core.files.glb import load_glb
from farfield.addon.core.geometry.mesh import TriangleMesh, longest_side
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.core.unwrap.unwrapping import unwrap

REAL_MODELS = {
    "spot": "textured/spot/spot.obj",
    "blub": "textured/blub/blub.glb",
    "fuze": "hard_surface/fuze.obj",
    "capsule": "hard_surface/capsule.obj",
    "truck": "hard_surface/CesiumMilkTruck.glb",
}
BUNNY = "meshes/stanford_bunny.obj"
ISLAND_MARGIN = 0.04  # Relative to a cell of the texture.
BUMPS = 40
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


def open_model(data: Path, name: str) -> TexturedMesh:
    """Return the model `name`: one of REAL_MODELS, `bunny`, or KIND:SEED with one of GENERATORS."""
    if name in REAL_MODELS:
        path = data / REAL_MODELS[name]
        return turn_upright(texmesh_files.read_glb(path)) if path.suffix == ".glb" else texmesh_files.read_obj(path)
    if name == "bunny":
        return unwrap_model(data / BUNNY)
    kind, seed = name.split(":")
    return GENERATORS[kind](np.random.default_rng(int(seed)))


def turn_upright(mesh: TexturedMesh) -> TexturedMesh:
    """Return a mesh of a .glb, in which y is up, with z up as in Blender."""
    return replace(mesh, vertices=mesh.vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0])


def unwrap_model(path: Path) -> TexturedMesh:
    """Return the mesh of an .obj without texture coordinates, unwrapped by Farfield."""
    points, faces = [], []
    for line in path.read_text("utf-8").splitlines():
        words = line.split()
        if words and words[0] == "v":
            points.append([float(word) for word in words[1:4]])
        elif words and words[0] == "f":
            faces.append([int(word.split("/")[0]) - 1 for word in words[1:4]])
    return unwrap_triangles(TriangleMesh(np.array(points), np.array(faces, np.int32)), path.stem)


def unwrap_triangles(mesh: TriangleMesh, name: str) -> TexturedMesh:
    """Return `mesh`, unwrapped by Farfield."""
    count = len(mesh.triangles)
    result = run_to_end(unwrap(mesh, np.arange(count), np.zeros((0, 2), int), np.zeros(count), UnwrapSettings(), name))
    return build_textured_mesh(mesh, result.corner_uvs, name=name)


def generate_planet(generator: np.random.Generator) -> TexturedMesh:
    """Return a bumpy ball of 24 islands, of different scale and distortion: 12,288 triangles."""
    grid, points = 16, []
    for axis in range(3):
        for side in (-1.0, 1.0):
            for row in range(2):
                for column in range(2):
                    x, y = np.meshgrid(np.linspace(row - 1, row, grid + 1), np.linspace(column - 1, column, grid + 1), indexing="ij")
                    patch = np.roll(np.stack([np.full_like(x, side), side * x, y], axis=2), axis, axis=2)
                    points.append(np.tan(0.25 * np.pi * patch))
    directions = np.stack(points)
    directions /= np.linalg.norm(directions, axis=3, keepdims=True)
    return _build_patches(directions, make_bumps(generator), generator, np.zeros(len(directions), np.int32))


def generate_ring(generator: np.random.Generator, grid: tuple[int, int] = (32, 16)) -> TexturedMesh:
    """Return a bumpy torus of 18 islands and two materials: 18,432 triangles. grid: cells along the sides of an island."""
    along, around = 6, 3
    points = []
    for row in range(along):
        for column in range(around):
            longitude = 2.0 * np.pi * (row + np.linspace(0.0, 1.0, grid[0] + 1)[:, None]) / along
            latitude = 2.0 * np.pi * (column + np.linspace(0.0, 1.0, grid[1] + 1)) / around
            radius = 1.0 + 0.35 * np.cos(latitude)
            height = 0.35 * np.sin(latitude) + 0.0 * longitude
            points.append(np.stack([radius * np.cos(longitude), radius * np.sin(longitude), height], axis=2))
    materials = (np.arange(len(points)) // around % 2).astype(np.int32)
    return _build_patches(np.stack(points), make_bumps(generator), generator, materials)


def generate_mirrored(generator: np.random.Generator) -> TexturedMesh:
    """Return a closed, symmetric body whose halves use the same, mirrored part of the texture: 10,368 triangles."""
    grid, halves = (36, 36), []
    longitude = np.linspace(0.0, np.pi, grid[0] + 1)
    bump = make_bumps(generator)
    for row in range(2):
        latitude = np.pi * (0.02 + 0.96 * (row + np.linspace(0.0, 1.0, grid[1] + 1)[:, None]) / 2.0)
        across = np.sin(latitude) * (0.8 + 0.3 * np.sin(3.0 * latitude))
        half = np.stack(
            [
                across * np.cos(longitude),
                across * np.sin(longitude),
                1.3 * np.cos(latitude) + 0 * longitude,
            ],
            axis=2,
        )
        half = bump(half)
        half[:, [0, -1], 1] = 0.0
        halves.append(half)
    uvs = [place_island(grid_uvs(half.shape[:2]), index, 1, generator) for index, half in enumerate(halves)]
    points = [*halves, *(half[::-1] * [1.0, -1.0, 1.0] for half in halves)]
    uvs += [uv[::-1] for uv in uvs]
    return join_patches(points, uvs, np.zeros(4, np.int32))


def grid_uvs(shape: tuple[int, int]) -> np.ndarray:
    """Return the unit square (*shape, 2)."""
    return np.stack(np.meshgrid(np.linspace(0.0, 1.0, shape[0]), np.linspace(0.0, 1.0, shape[1]), indexing="ij"), axis=2)


def make_bumps(generator: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """Return a smooth random displacement of positions (..., 3)."""
    centers = generator.normal(size=(BUMPS, 3))
    centers /= np.linalg.norm(centers, axis=1, keepdims=True)
    widths = np.exp(generator.uniform(np.log(0.1), np.log(0.6), BUMPS))
    heights = generator.normal(scale=0.4, size=(BUMPS, 3)) * widths[:, None]

    def displace(points: np.ndarray) -> np.ndarray:
        result = points.copy()
        for center, width, height in zip(centers, widths, heights, strict=True):
            result += np.exp(-((points - center) ** 2).sum(axis=-1, keepdims=True) / (2.0 * width**2)) * height
        return result

    return displace


def place_island(uvs: np.ndarray, index: int, cells: int, generator: np.random.Generator) -> np.ndarray:
    """Return the unit square `uvs` (..., 2) distorted, turned, mirrored and moved to cell `index` of a square of cells."""
    columns = int(np.ceil(np.sqrt(max(cells, 2))))
    u, v = uvs[..., 0], uvs[..., 1]
    curvature, skew = generator.uniform(-0.25, 0.25, 4), generator.uniform(-0.2, 0.2, 2)
    warped = np.stack(
        [
            u + curvature[0] * np.sin(np.pi * u) * v + curvature[1] * u * (1.0 - u) + skew[0] * v,
            v + curvature[2] * np.sin(np.pi * v) * u + curvature[3] * v * (1.0 - v) + skew[1] * u,
        ],
        axis=-1,
    )
    if generator.uniform() < 0.5:
        warped = warped[..., ::-1]
    low = warped.min(axis=(0, 1))
    warped = (warped - low) / np.ptp(warped, axis=(0, 1)).max()
    warped = ISLAND_MARGIN + (1.0 - 2.0 * ISLAND_MARGIN) * generator.uniform(0.6, 1.0) * warped
    return (warped + np.array([index % columns, index // columns])) / columns


def _build_patches(patches: np.ndarray, bump: Callable, generator: np.random.Generator, materials: np.ndarray) -> TexturedMesh:
    uvs = [place_island(grid_uvs(patches.shape[1:3]), index, len(patches), generator) for index in range(len(patches))]
    return join_patches([bump(np.round(patch, 9)) for patch in patches], uvs, materials)


def join_patches(points: list[np.ndarray], uvs: list[np.ndarray], materials: np.ndarray) -> TexturedMesh:
    """Return the triangles of grids (R, C, 3) with texture coordinates (R, C, 2) and a material each, one unit along the longest side."""
    triangles, corner_uvs, owners, offset = [], [], [], 0
    for index, (patch, patch_uvs) in enumerate(zip(points, uvs, strict=True)):
        numbers = np.arange(patch[..., 0].size).reshape(patch.shape[:2])
        a, b, c, d = numbers[:-1, :-1], numbers[1:, :-1], numbers[1:, 1:], numbers[:-1, 1:]
        faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=-2).reshape(-1, 3)
        triangles.append(faces + offset)
        corner_uvs.append(patch_uvs.reshape(-1, 2)[faces])
        owners.append(np.full(len(faces), materials[index]))
        offset += numbers.size
    vertices = np.concatenate([patch.reshape(-1, 3) for patch in points])
    vertices = np.round(vertices / longest_side(vertices), 9)
    mesh = TriangleMesh(vertices, np.concatenate(triangles).astype(np.int32), np.concatenate(owners).astype(np.int32))
    return build_textured_mesh(mesh, np.concatenate(corner_uvs), name="generated")


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
    document = load_glb(path.read_bytes())
    images: list[np.ndarray | None] = []
    for material in document["materials"][:count]:
        texture = material.get("pbrMetallicRoughness", {}).get("baseColorTexture")
        source = None if texture is None else document["images"][document["textures"][texture["index"]]["source"]]
        images.append(None if source is None else read_image(io.BytesIO(source["content"])))
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


GENERATORS = {"planet": generate_planet, "ring": generate_ring, "mirrored": generate_mirrored}
