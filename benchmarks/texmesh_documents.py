"""glTF documents of levels with images of all maps, for `bench_texmesh.py`, without Blender."""

import numpy as np

from farfield.addon.core.files.glb import Document
from farfield.addon.core.geometry.mesh import vertex_normals
from farfield.addon.core.geometry.transforms import normalize
from farfield.addon.core.imaging.coded_images import encode
from farfield.addon.core.imaging.colors import encode_signed_srgb
from farfield.addon.core.texmesh.level_chain import LevelChain
from farfield.addon.core.texmesh.rebaking.texture_uses import LevelDocument
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

NAMES = ("baseColorTexture", "metallicRoughnessTexture", "normalTexture", "emissiveTexture")
STEEPNESS = 4.0  # Steepness of the normal map.


def draw_maps(texture: np.ndarray) -> list[bytes]:
    """Return PNG files of color, roughness, normals and emission that have the patterns of a texture (S, S, 3), linear light."""
    heights = texture.mean(axis=2)
    pixels = np.empty((4, *texture.shape), np.uint8)
    for row in range(len(texture)):  # one row at a time, in little memory
        along, across = np.roll(heights[row], -1) - np.roll(heights[row], 1), heights[(row + 1) % len(heights)] - heights[row - 1]
        normals = normalize(np.stack([-STEEPNESS * along, -STEEPNESS * across, np.ones_like(along)], axis=1))
        images = (encode_signed_srgb(texture[row]), texture[row, :, ::-1], 0.5 + 0.5 * normals, encode_signed_srgb(texture[-1 - row]))
        pixels[:, row] = np.rint(255.0 * np.clip(images, 0.0, 1.0))
    return [encode(image, "png") for image in pixels]


def list_documents(chain: LevelChain, maps: list[bytes]) -> list[LevelDocument]:
    """Return the documents of all levels."""
    return [LevelDocument(_describe(level.mesh, maps), {"object": level.pixel_size}, {}) for level in chain.levels]


def _describe(mesh: TexturedMesh, maps: list[bytes]) -> Document:
    textures = {name: {"index": index} for index, name in enumerate(NAMES)}
    surface = {name: textures.pop(name) for name in NAMES[:2]}
    normals = vertex_normals(mesh.vertices, mesh.triangles)[mesh.wedge_vertices]
    attributes = {
        "POSITION": mesh.vertices[mesh.wedge_vertices],
        "NORMAL": normals,
        "TANGENT": _find_tangents(mesh, normals),
        "TEXCOORD_0": mesh.uvs * [1.0, -1.0] + [0.0, 1.0],
    }
    return {
        "nodes": [{"name": "object", "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": mesh.wedge_triangles.ravel(), "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": surface, **textures}],
        "textures": [{"source": index} for index in range(len(maps))],
        "images": [{"content": content, "name": name} for content, name in zip(maps, NAMES, strict=True)],
    }


def _find_tangents(mesh: TexturedMesh, normals: np.ndarray) -> np.ndarray:
    """Return tangents (W, 4): the mean direction of u, perpendicular to the normal."""
    corners, uvs = mesh.vertices[mesh.triangles], mesh.corner_uvs
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    first_v, second_v = (uvs[:, index, 1:] - uvs[:, 0, 1:] for index in (1, 2))
    directions = first * second_v - second * first_v
    sums = np.zeros_like(normals)
    for corner in range(3):
        np.add.at(sums, mesh.wedge_triangles[:, corner], directions)
    tangents = normalize(sums - normals * np.einsum("nc,nc->n", sums, normals)[:, None])
    return np.concatenate([tangents, np.ones((len(normals), 1))], axis=1)
