"""Reading of binary glTF 2.0 files that are not damaged: nodes, triangles, and materials with their images."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from farfield.addon.core.files.glb import Document, load_glb
from farfield.addon.core.files.glb_levels import LEVELS, SCREEN_COVERAGE, TEXTURE_TRANSFORM


@dataclass(frozen=True, eq=False)
class ReadPrimitive:
    """Triangles: floats by attribute of the file, with v downwards; triangles (T, 3); the index of the material."""

    attributes: dict[str, np.ndarray]
    triangles: np.ndarray
    material: int | None

    @property
    def positions(self) -> np.ndarray:
        """(V, 3), in the space of the mesh."""
        return self.attributes["POSITION"]


@dataclass(frozen=True, eq=False)
class ReadMesh:
    """A mesh."""

    name: str
    primitives: tuple[ReadPrimitive, ...]


@dataclass(frozen=True, eq=False)
class ReadNode:
    """A node without parents: its mesh, its matrix (4, 4), the nodes that replace it, and their screen coverages."""

    name: str
    mesh: int
    matrix: np.ndarray
    levels: tuple[int, ...]
    coverages: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class ReadGlb:
    """A file. materials: as in the file, but textures have their "image" (bytes), "sampler" and "matrix" (2, 3) instead of indices."""

    document: dict[str, Any]
    nodes: tuple[ReadNode, ...]
    meshes: tuple[ReadMesh, ...]
    materials: tuple[dict[str, Any], ...]
    images: tuple[bytes, ...]

    def world_positions(self, node: int = 0, part: int = 0) -> np.ndarray:
        """The vertices (V, 3) of a primitive in world space."""
        matrix = self.nodes[node].matrix
        return self.meshes[self.nodes[node].mesh].primitives[part].positions @ matrix[:3, :3].T + matrix[:3, 3]


def read_glb(path: Path) -> ReadGlb:
    """Return the content of a file."""
    return parse_glb(path.read_bytes())


def parse_glb(content: bytes) -> ReadGlb:
    """Return the content of a file in memory."""
    return read_document(load_glb(content))


def read_document(document: Document) -> ReadGlb:
    """Return the content of a document with arrays."""
    meshes = tuple(ReadMesh(mesh["name"], tuple(map(_read_primitive, mesh["primitives"]))) for mesh in document["meshes"])
    images = tuple(image["content"] for image in document.get("images", ()))
    materials = tuple(_resolve(document, images, material) for material in document.get("materials", ()))
    return ReadGlb(document, tuple(_read_node(node) for node in document["nodes"] if "mesh" in node), meshes, materials, images)


def _read_primitive(part: Document) -> ReadPrimitive:
    attributes = {name: values.astype(np.float64) for name, values in part["attributes"].items()}
    return ReadPrimitive(attributes, part["indices"].reshape(-1, 3), part.get("material"))


def _read_node(node: dict[str, Any]) -> ReadNode:
    matrix = np.array(node.get("matrix", np.eye(4)), np.float64).reshape(4, 4).T
    levels = node.get("extensions", {}).get(LEVELS, {}).get("ids", ())
    return ReadNode(node["name"], node["mesh"], matrix, tuple(levels), tuple(node.get("extras", {}).get(SCREEN_COVERAGE, ())))


def _resolve(document: dict[str, Any], images: tuple[bytes, ...], value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    if "index" not in value:
        return {key: _resolve(document, images, item) for key, item in value.items()}
    texture = document["textures"][value["index"]]
    sampler = document["samplers"][texture["sampler"]] if "sampler" in texture else {}
    placement = value.get("extensions", {}).get(TEXTURE_TRANSFORM, {})
    angle, scale = placement.get("rotation", 0.0), np.array(placement.get("scale", (1.0, 1.0)))
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])  # v is downwards
    others = {key: item for key, item in value.items() if key not in ("index", "extensions")}
    matrix = np.column_stack([turn * scale, placement.get("offset", (0.0, 0.0))])
    return {**others, "image": images[texture["source"]], "sampler": sampler, "matrix": matrix}
