"""Where the materials of a glTF document use images, and on which triangles."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...files.glb import Document
from ...files.glb_levels import TEXTURE_TRANSFORM, find_uv_map, list_textures, turn_of
from .smaller_images import Content
from .tangent_normals import TangentSurface

COLORS = {"baseColorTexture", "emissiveTexture", "sheenColorTexture", "specularColorTexture"}
NORMALS = {"normalTexture", "clearcoatNormalTexture"}
REPEAT = 10497  # as wrap mode of samplers


@dataclass(frozen=True, eq=False)
class LevelDocument:
    """A document of Blender's exporter with one level per object. Equal images are the same object.

    Attributes:
        document: with arrays and images, see `core.files.glb`, and with tangents.
        pixel_sizes: the smallest size of a pixel at which each node shows, in the unit of its mesh, by the name of the node.
        tangent_maps: the number of the UV map that has the tangents, by the name of the node.
    """

    document: Document
    pixel_sizes: Mapping[str, float]
    tangent_maps: Mapping[str, int]


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles with one material.

    Attributes:
        primitive: of the document.
        pixel_size: the smallest size of a pixel at which it shows.
        tangent_map: the number of the UV map that has the tangents.
    """

    primitive: Document
    pixel_size: float
    tangent_map: int

    def at_corners(self, name: str) -> np.ndarray:
        """Return an attribute of the corners of triangles, (T, 3, C)."""
        return self.primitive["attributes"][name][self.primitive["indices"].reshape(-1, 3)]


@dataclass(frozen=True, eq=False)
class TextureUse:
    """An image in a material.

    Attributes:
        reference: what the material says about its texture.
        image: the image of the document.
        content: what the image holds there.
        is_repeated: whether the image repeats beyond its sides.
        parts: the triangles, as far as they have the UV map.
    """

    reference: Document
    image: Document
    content: Content
    is_repeated: bool
    parts: tuple[Part, ...]

    @property
    def is_placed(self) -> bool:
        """Whether the image lies elsewhere than the UV map says."""
        return TEXTURE_TRANSFORM in self.reference.get("extensions", {})

    def list_uvs(self) -> list[np.ndarray]:
        """Return where the corners of triangles are in the image, (T, 3, 2) per part, v upwards, 1 for a side."""
        placement = self.reference.get("extensions", {}).get(TEXTURE_TRANSFORM, {})
        matrix = turn_of(placement) * placement.get("scale", (1.0, 1.0))
        offset = placement.get("offset", (0.0, 0.0))
        uvs = [part.at_corners(f"TEXCOORD_{find_uv_map(self.reference)}") @ matrix.T + offset for part in self.parts]
        return [values * [1.0, -1.0] + [0.0, 1.0] for values in uvs]

    def list_surfaces(self) -> list[TangentSurface] | None:
        """Return the surface of each part, None if it has no tangents for the UV map of the image."""
        uv_map = find_uv_map(self.reference)
        if self.is_placed or any("TANGENT" not in part.primitive["attributes"] or part.tangent_map != uv_map for part in self.parts):
            return None
        return [
            TangentSurface(uvs, part.at_corners("NORMAL"), part.at_corners("TANGENT"))
            for uvs, part in zip(self.list_uvs(), self.parts, strict=True)
        ]


def list_uses(level: LevelDocument) -> list[TextureUse]:
    """Return all uses of images in a document."""
    document = level.document
    parts = list(_list_parts(level))
    uses = []
    for index, material in enumerate(document.get("materials", ())):
        is_opaque = material.get("alphaMode", "OPAQUE") == "OPAQUE"
        for name, reference in list_textures(material):
            attribute = f"TEXCOORD_{find_uv_map(reference)}"
            shown = [part for part in parts if part.primitive.get("material") == index and attribute in part.primitive["attributes"]]
            texture = document["textures"][reference["index"]]
            sampler = document["samplers"][texture["sampler"]] if "sampler" in texture else {}
            is_repeated = all(sampler.get(key, REPEAT) == REPEAT for key in ("wrapS", "wrapT"))
            content = _find_content(name, is_opaque)
            uses.append(TextureUse(reference, document["images"][texture["source"]], content, is_repeated, tuple(shown)))
    return uses


def _find_content(name: str, is_opaque: bool) -> Content:
    if name in NORMALS:
        return Content.NORMAL
    if name not in COLORS:
        return Content.DATA
    return Content.COLOR if is_opaque or name != "baseColorTexture" else Content.TRANSPARENT_COLOR


def _list_parts(level: LevelDocument) -> Iterator[Part]:
    for node in level.document["nodes"]:
        if "mesh" in node:
            for primitive in level.document["meshes"][node["mesh"]]["primitives"]:
                yield Part(primitive, level.pixel_sizes.get(node["name"], 0.0), level.tangent_maps.get(node["name"], 0))


def replace_images(document: Document, uses: Sequence[TextureUse], contents: Mapping[int, bytes]) -> None:
    """Let `uses`, which are all, have other images, by index of the use, and drop images and textures that nothing uses any more."""
    images: dict[bytes, Document] = {}
    textures: list[Document] = []
    used = [document["textures"][use.reference["index"]] for use in uses]
    for index, (use, texture) in enumerate(zip(uses, used, strict=True)):
        content = contents.get(index, use.image["content"])
        images.setdefault(content, {**use.image, "content": content})
        texture = {**texture, "source": list(images).index(content)}
        textures += [] if texture in textures else [texture]
        use.reference["index"] = textures.index(texture)
    document["images"], document["textures"] = list(images.values()), textures
