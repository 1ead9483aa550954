"""What a package contains.

A package is a folder of static files:

| file | content |
|---|---|
| manifest.json | `Manifest`: byte ranges are [offset, size, CRC-32 of the bytes], headers of AVIF files are hexadecimal |
| mesh.bin | sections of the levels, coarsest first, see `MeshLevel` |
| textures.bin | the tables of increments and of their checksums, and the increments |

Everything that is compressed is raw DEFLATE (RFC 1951), which browsers decode.
"""

import json
import re
import zlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError
from ..files.file_access import exists, read_file
from ..json_values import integer, numbers, parse_json, text
from .shading import DEFAULT_SHADING, Shading, decode_shading
from .tile_pyramid import TilePyramid

FORMAT, VERSION = "farfield-package", 4
MAX_MANIFEST_BYTES = 16 * 2**20
MAX_FILE_BYTES = 2**40
MAX_INCREMENTS = 2**20
URL = re.compile(r"(https?://)(\[[^]/]+\]|[^]/:@]+)(:[0-9]{1,5})?/(?:.*/)?")  # scheme, host and port of a folder
HOST = re.compile(r"[A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\]")
MAX_NUMBER = 1e30
MANIFEST, MESH, TEXTURES = "manifest.json", "mesh.bin", "textures.bin"
MAX_TEXTURE_SIDE = 65536
MAX_STEPS = 65535  # Positions and texture coordinates are 16-bit numbers.
MAX_TILES = 65536  # Tiles of one texture, as tile indices have 16 bits.
MAX_STATES = 64  # States of textures; the controller of a page compares all.
MIN_EXPONENT, MAX_EXPONENT = 1.0, 8.0  # Exponents with which errors combine.
ROLES = ("base_color", "alpha", "normal", "roughness", "metallic", "occlusion", "emission")


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

    To decode a level needs all sections of coarser ones, see `mesh.coding`.

    Attributes:
        vertex_count, wedge_count: of the level; those of coarser levels are included and come first.
        triangle_counts: per material; triangles are sorted by material.
        positions, uvs: sections of mesh.bin for the added vertices and wedges.
        parents: section with the parents of the added vertices.
        wedges, corners: sections with all triangles of the level.
        pixels: size of the object in the image, in pixels, up to which the level looks the same as the next finer one; 0 for the finest.
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
    """A texture.

    Attributes:
        role: one of ROLES.
        width, height: in pixels.
        tile_size: side of the tiles in pixels, see `TilePyramid`; those at the right and lower border are padded.
        headers: beginnings of AVIF files, see `textures.avif_files`; each tile uses one of them.
    """

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
    """A material.

    Attributes:
        name: of the material.
        base_color: scene-linear RGBA, multiplied with the textures.
        textures: indices into those of the package, by role.
        is_double_sided: whether back faces show.
        shading: its other factors.
    """

    name: str
    base_color: tuple[float, float, float, float]
    textures: dict[str, int]
    is_double_sided: bool
    shading: Shading = DEFAULT_SHADING


@dataclass(frozen=True)
class ErrorModel:
    """Predicted mean FLIP errors: of each level, coarsest first, with whole textures, of each state of the textures with the finest level,
    and the exponent with which both combine. Errors are 0 to 1 and never rise."""

    levels: tuple[float, ...]
    states: tuple[float, ...]
    exponent: float

    def tabulate(self) -> tuple[tuple[float, ...], ...]:
        """Return the errors of each level with each state."""
        errors = combine_errors(np.array(self.levels)[:, None], np.array(self.states)[None], self.exponent)
        return tuple(tuple(row) for row in np.minimum(errors, 1.0).tolist())


def combine_errors(first: np.ndarray | float, second: np.ndarray | float, exponent: float) -> np.ndarray:
    """Return the error of two independent causes: the sum with `exponent` 1, the larger one with a large exponent."""
    largest = np.maximum(np.maximum(first, second), 1e-12)
    return largest * ((first / largest) ** exponent + (second / largest) ** exponent) ** (1.0 / exponent)


@dataclass(frozen=True)
class Manifest:
    """What a package contains.

    Attributes:
        name: of the object.
        files: size and SHA-256 (hexadecimal) by name.
        mirrors: URLs of folders with copies, ending in "/".
        bounds: (2, 3), lowest and highest position, y upwards.
        uv_bounds: (2, 2), lowest and highest texture coordinate, v downwards as in glTF.
        steps: numbers of steps between the bounds of positions and of texture coordinates, at most MAX_STEPS.
        levels: coarsest first.
        materials: in the order of the triangle counts of levels.
        textures: what materials refer to by index.
        increment_count, increments, checksums: see `increments`.
        first_increment: offset of the first increment in textures.bin.
        errors: of levels and of states of the textures; without increments there is one state.
        state_pixels: of each state, the size of the object in the image up to which it looks like the last one; 0 for the last one.
        time_limit: seconds.
        pixels: size of the object in the image that the errors are for.
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
    state_pixels: tuple[float, ...]
    time_limit: float
    pixels: float

    @property
    def state_count(self) -> int:
        """The number of states of the textures, 1 without increments."""
        return len(self.errors.states)

    def mesh_size(self, level: int) -> int:
        """Return the bytes of mesh.bin that show `level`: those of this level and of all coarser ones."""
        return sum(item.size for item in self.levels[: level + 1])


def encode_manifest(manifest: Manifest) -> bytes:
    """Return `manifest` as JSON. The same manifest gives the same bytes."""
    content = {"format": FORMAT, "version": VERSION, **asdict(manifest)}
    for level in content["levels"]:
        level.update({key: list(value.values()) for key, value in level.items() if isinstance(value, dict)})
    for texture in content["textures"]:
        texture["headers"] = [header.hex() for header in texture["headers"]]
    content |= {key: list(content[key].values()) for key in ("increments", "checksums")}
    return json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()


def decode_manifest(content: bytes) -> Manifest:
    """Return the manifest that `encode_manifest` encoded; its sizes and references agree with each other.

    Raises:
        FileError: it is no manifest of a package, is damaged, contradicts itself, or is of a newer version.
    """
    try:
        values = parse_json(content)
        if not isinstance(values, dict) or values.get("format") != FORMAT:
            raise FileError("manifest.json is not that of a package of Farfield; choose the folder that Export Package wrote.")
        if integer(values["version"], "version", 0, 2**31) != VERSION:
            raise FileError(
                f"The package has version {values['version']} of the format, but this Farfield reads {VERSION}; update Farfield."
            )
        manifest = _to_manifest(values)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileError("manifest.json is damaged; export the package again.") from error
    _check(manifest)
    return manifest


def read_manifest(folder: Path) -> Manifest:
    """Return the manifest of the package in `folder`.

    Raises:
        FileError: see `decode_manifest`, or it cannot be read.
    """
    path = folder / MANIFEST
    if not exists(path):
        raise FileError(f'"{folder}" contains no "{MANIFEST}"; choose the folder that Export Package wrote.')
    return decode_manifest(read_file(path, MAX_MANIFEST_BYTES))


def _to_manifest(values: dict[str, Any]) -> Manifest:
    return Manifest(
        name=_text(values["name"]),
        files={_text(name): (_integer(size), _text(digest)) for name, (size, digest) in values["files"].items()},
        mirrors=tuple(_text(url) for url in values["mirrors"] if find_origin(url)),
        bounds=_to_bounds(values["bounds"], 3),
        uv_bounds=_to_bounds(values["uv_bounds"], 2),
        steps=tuple(_integer(count) for count in values["steps"]),
        levels=tuple(_to_level(level) for level in values["levels"]),
        materials=tuple(
            PackageMaterial(
                _text(item["name"]),
                _finite(item["base_color"], 4),
                {_text(role): _integer(index) for role, index in item["textures"].items()},
                item["is_double_sided"] is True,
                decode_shading(item["shading"]),
            )
            for item in values["materials"]
        ),
        textures=tuple(
            PackageTexture(
                _text(item["role"]),
                *(_integer(item[key]) for key in ("width", "height", "tile_size")),
                tuple(bytes.fromhex(header) for header in item["headers"]),
            )
            for item in values["textures"]
        ),
        increment_count=_integer(values["increment_count"]),
        increments=_to_section(values["increments"]),
        checksums=_to_section(values["checksums"]),
        first_increment=_integer(values["first_increment"]),
        errors=_to_errors(values["errors"]),
        state_pixels=_finite(values["state_pixels"], len(values["state_pixels"])),
        time_limit=_finite([values["time_limit"]], 1)[0],
        pixels=_finite([values["pixels"]], 1)[0],
    )


def find_origin(url: str) -> str:
    """Return scheme, host and port of the URL of a folder on a web server, as a Content Security Policy names them.

    Raises:
        ValueError: it is no such URL.
    """
    match = URL.fullmatch(url)
    host = match[2].encode("idna").decode() if match is not None and not match[2].startswith("[") else match and match[2]
    if not host or not HOST.fullmatch(host):
        raise ValueError("a mirror is no URL of a folder on a web server")
    return f"{match[1]}{host}{match[3] or ''}"


def _to_errors(values: dict[str, Any]) -> ErrorModel:
    levels, states = (_finite(values[key], len(values[key])) for key in ("levels", "states"))
    return ErrorModel(levels, states, _finite([values["exponent"]], 1)[0])


def _to_level(values: dict[str, Any]) -> MeshLevel:
    return MeshLevel(
        _integer(values["vertex_count"]),
        _integer(values["wedge_count"]),
        tuple(_integer(count) for count in values["triangle_counts"]),
        *(_to_section(values[key]) for key in ("positions", "parents", "wedges", "uvs", "corners")),
        *_finite([values["pixels"]], 1),
    )


def _to_section(values: list[Any]) -> Section:
    return Section(*(_integer(value) for value in values))


def _to_bounds(values: list[Any], dimension: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    low, high = values
    return _finite(low, dimension), _finite(high, dimension)


def _integer(value: object) -> int:
    return integer(value, "a count", 0, MAX_FILE_BYTES)


def _finite(values: object, count: int) -> tuple[Any, ...]:
    return numbers(values, "a list", count, -MAX_NUMBER, MAX_NUMBER)


def _text(value: object) -> str:
    return text(value, "a text")


def _check(manifest: Manifest) -> None:
    """Raise FileError if sizes or references of `manifest` contradict each other."""
    mesh_size, textures_size = (manifest.files.get(name, (-1, ""))[0] for name in (MESH, TEXTURES))
    if mesh_size < 0 or textures_size < 0:
        raise _contradiction("it does not list mesh.bin and textures.bin")
    if len(manifest.steps) != 2 or not all(0 < count <= MAX_STEPS for count in manifest.steps):
        raise _contradiction("its numbers of steps are not possible")
    if not manifest.levels or not manifest.materials:
        raise _contradiction("it has no level or no material")
    for level, coarser in zip(manifest.levels, (None, *manifest.levels), strict=False):
        sections = (level.positions, level.parents, level.wedges, level.uvs, level.corners)
        if any(section.end > mesh_size for section in sections):
            raise _contradiction("a section of a level ends behind mesh.bin")
        if coarser and (level.vertex_count < coarser.vertex_count or level.wedge_count < coarser.wedge_count):
            raise _contradiction("a level has fewer vertices than a coarser one")
        if len(level.triangle_counts) != len(manifest.materials) or level.wedge_count < level.vertex_count:
            raise _contradiction("counts of a level do not fit")
    for texture in manifest.textures:
        has_sides = all(0 < side <= MAX_TEXTURE_SIDE for side in (texture.width, texture.height, texture.tile_size))
        if texture.role not in ROLES or not has_sides or texture.tile_count > MAX_TILES or not texture.headers:
            raise _contradiction(f"a texture has the role {texture.role!r}, no header, or a size that is not possible")
    for material in manifest.materials:
        if any(index >= len(manifest.textures) for index in material.textures.values()):
            raise _contradiction(f'the material "{material.name}" has a texture that does not exist')
    tables = (manifest.increments, manifest.checksums)
    if any(table.end > manifest.first_increment for table in tables) or manifest.first_increment > textures_size:
        raise _contradiction("the table of increments ends behind the first one")
    if manifest.increment_count > min(textures_size - manifest.first_increment, MAX_INCREMENTS):  # each has at least one byte
        raise _contradiction("it has more increments than bytes of them")
    if manifest.state_count > max(manifest.increment_count, 1):  # each state adds some
        raise _contradiction("it has more states than increments")
    errors = manifest.errors
    if len(errors.levels) != len(manifest.levels) or not 1 <= manifest.state_count <= MAX_STATES:
        raise _contradiction("its errors do not fit to its levels")
    if len(manifest.state_pixels) != manifest.state_count or min(manifest.state_pixels) < 0.0:
        raise _contradiction("its sizes of states do not fit")
    if not all(_falls(values) for values in (errors.levels, errors.states)) or not MIN_EXPONENT <= errors.exponent <= MAX_EXPONENT:
        raise _contradiction("its errors rise, or are not possible")
    if manifest.time_limit <= 0.0 or manifest.pixels <= 0.0 or not np.all(np.less_equal(*manifest.bounds)):
        raise _contradiction("its time limit, size in pixels or bounds are not possible")


def _falls(errors: tuple[float, ...]) -> bool:
    return all(0.0 <= last <= first <= 1.0 for first, last in zip(errors, (*errors[1:], errors[-1]), strict=True))


def _contradiction(what: str) -> FileError:
    return FileError(f"manifest.json contradicts itself: {what}; export the package again.")
