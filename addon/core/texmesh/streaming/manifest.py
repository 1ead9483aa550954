"""What a package contains.

A package is a folder of static files:

| file | content |
|---|---|
| manifest.json | `Manifest`, see `manifest_json` |
| mesh.bin | sections of the levels, coarsest first, see `MeshLevel` |
| textures.bin | the tables of increments and of their checksums, and the increments |

Everything that is compressed is raw DEFLATE (RFC 1951), which browsers decode.
"""

import zlib
from dataclasses import dataclass

from ...errors import FileError
from .error_model import ErrorModel
from .tile_pyramid import TilePyramid

FORMAT, VERSION = "farfield-package", 3
MANIFEST, MESH, TEXTURES = "manifest.json", "mesh.bin", "textures.bin"
MAX_TEXTURE_SIDE = 65536
MAX_STEPS = 65535  # of positions and texture coordinates, which are 16-bit numbers
MAX_TILES = 65536  # of one texture: tile indices are 16 bits
MAX_STATES = 64  # of textures: the controller of a page compares all
ROLES = ("base_color", "normal", "roughness", "metallic", "occlusion", "emission")


@dataclass(frozen=True)
class Section:
    """`size` bytes at `offset` of a file, and their CRC-32."""

    offset: int
    size: int
    crc32: int

    @property
    def end(self) -> int:
        return self.offset + self.size

    def read(self, content: bytes | memoryview, name: str) -> memoryview:
        """Return the bytes of this section of a whole file.

        Raises:
            FileError: the file is too short, or the bytes are others than were written.
        """
        part = memoryview(content)[self.offset : self.end]
        if len(part) != self.size or zlib.crc32(part) != self.crc32:
            raise FileError(f'"{name}" of the package is damaged at byte {self.offset}; export the package again, or copy it again.')
        return part


@dataclass(frozen=True)
class MeshLevel:
    """What a level adds to the coarser ones.

    vertex_count, wedge_count: of the level, those of coarser levels included: they come first. triangle_counts: per material; triangles
    are sorted by material. positions, uvs: sections of mesh.bin for the added vertices and wedges. corners, wedges, parents: sections with
    the level's triangles, all of them, and the parents of the added vertices. See `mesh_coding`: to decode a level needs all sections of
    coarser ones. pixels: size of the object in the image, in pixels, up to which the level looks the same as the next finer one; 0 for the
    finest.
    """

    vertex_count: int
    wedge_count: int
    triangle_counts: tuple[int, ...]
    positions: Section
    parents: Section
    wedges: Section
    uvs: Section
    corners: Section
    pixels: float

    @property
    def size(self) -> int:
        """Bytes of all sections."""
        return self.corners.size + self.wedges.size + self.parents.size + self.positions.size + self.uvs.size


@dataclass(frozen=True)
class PackageTexture:
    """A texture. Tiles are squares of `tile_size` pixels, see `TilePyramid`; those at the right and lower border are padded. headers:
    beginnings of AVIF files, see `textures.avif_files`; each tile uses one of them."""

    role: str
    width: int
    height: int
    tile_size: int
    headers: tuple[bytes, ...]

    @property
    def tile_count(self) -> int:
        """Tiles of all levels."""
        return TilePyramid(self.width, self.height, self.tile_size).tile_count


@dataclass(frozen=True)
class PackageMaterial:
    """A material. base_color: scene-linear RGBA, multiplied with the texture. textures: indices into those of the package, by role."""

    name: str
    base_color: tuple[float, float, float, float]
    textures: dict[str, int]
    is_double_sided: bool


@dataclass(frozen=True)
class Manifest:
    """What a package contains.

    name: of the object. files: size and SHA-256 (hexadecimal) by name. mirrors: URLs of folders with copies, ending in "/". bounds: (2, 3)
    lowest and highest position. uv_bounds: (2, 2) lowest and highest texture coordinate, v downwards as in glTF. steps: numbers of steps
    between them, at most MAX_STEPS. levels: coarsest first. increment_count, increments, checksums: see `increments`. first_increment:
    offset of the first increment in textures.bin. errors: of levels and states of the textures, of
    which there is one if there are no increments. time_limit: seconds. pixels: size of the object in the
    image that the errors are for.
    """

    name: str
    files: dict[str, tuple[int, str]]
    mirrors: tuple[str, ...]
    bounds: tuple[tuple[float, ...], tuple[float, ...]]
    uv_bounds: tuple[tuple[float, ...], tuple[float, ...]]
    steps: tuple[int, int]
    levels: tuple[MeshLevel, ...]
    materials: tuple[PackageMaterial, ...]
    textures: tuple[PackageTexture, ...]
    increment_count: int
    increments: Section
    checksums: Section
    first_increment: int
    errors: ErrorModel
    time_limit: float
    pixels: float

    @property
    def state_count(self) -> int:
        """The number of states of the textures, 1 without increments."""
        return len(self.errors.states)

    def mesh_size(self, level: int) -> int:
        """Return the bytes of mesh.bin that show `level`: those of this level and of all coarser ones."""
        return sum(item.size for item in self.levels[: level + 1])
