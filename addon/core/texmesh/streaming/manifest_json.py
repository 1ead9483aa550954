"""Manifests of packages as JSON: byte ranges are [offset, size, CRC-32 of the bytes], headers of AVIF files are hexadecimal."""

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileError
from .error_model import MAX_EXPONENT, MIN_EXPONENT, ErrorModel
from .manifest import (
    FORMAT,
    MANIFEST,
    MAX_STATES,
    MAX_STEPS,
    MAX_TEXTURE_SIDE,
    MAX_TILES,
    MESH,
    ROLES,
    TEXTURES,
    VERSION,
    Manifest,
    MeshLevel,
    PackageMaterial,
    PackageTexture,
    Section,
)

MAX_MANIFEST_BYTES = 16 * 2**20
MAX_FILE_BYTES = 2**40


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
        values = json.loads(content)
        if not isinstance(values, dict) or values.get("format") != FORMAT:
            raise FileError("manifest.json is not that of a package of Farfield; choose the folder that Export Package wrote.")
        if values["version"] != VERSION:
            raise FileError(
                f"The package has version {values['version']!r} of the format, but this Farfield reads {VERSION}; update Farfield."
            )
        manifest = _to_manifest(values)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise FileError("manifest.json is damaged; export the package again.") from error
    _check(manifest)
    return manifest


def read_manifest(folder: Path) -> Manifest:
    """Return the manifest of the package in `folder`.

    Raises:
        FileError: see `decode_manifest`, or it cannot be read.
    """
    path = folder / MANIFEST
    try:
        if path.stat().st_size > MAX_MANIFEST_BYTES:
            raise FileError(f'"{path}" is too large for a manifest; choose the folder that Export Package wrote.')
        return decode_manifest(path.read_bytes())
    except OSError as error:
        raise FileError(f'"{path}" cannot be read ({error.strerror or error}); choose the folder that Export Package wrote.') from error


def _to_manifest(values: dict[str, Any]) -> Manifest:
    return Manifest(
        name=str(values["name"]),
        files={str(name): (_integer(size), str(digest)) for name, (size, digest) in values["files"].items()},
        mirrors=tuple(str(url) for url in values["mirrors"]),
        bounds=_to_bounds(values["bounds"], 3),
        uv_bounds=_to_bounds(values["uv_bounds"], 2),
        steps=tuple(_integer(count) for count in values["steps"]),
        levels=tuple(_to_level(level) for level in values["levels"]),
        materials=tuple(
            PackageMaterial(
                str(item["name"]),
                _finite(item["base_color"], 4),
                {str(role): _integer(index) for role, index in item["textures"].items()},
                item["is_double_sided"] is True,
            )
            for item in values["materials"]
        ),
        textures=tuple(
            PackageTexture(
                str(item["role"]),
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
        time_limit=_finite([values["time_limit"]], 1)[0],
        pixels=_finite([values["pixels"]], 1)[0],
    )


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
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= MAX_FILE_BYTES:
        raise ValueError(value)
    return value


def _finite(values: list[Any], count: int) -> tuple[Any, ...]:
    numbers = tuple(float(value) for value in values)
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise ValueError(values)
    return numbers


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
    errors = manifest.errors
    if len(errors.levels) != len(manifest.levels) or not 1 <= manifest.state_count <= MAX_STATES:
        raise _contradiction("its errors do not fit to its levels")
    if not all(_falls(values) for values in (errors.levels, errors.states)) or not MIN_EXPONENT <= errors.exponent <= MAX_EXPONENT:
        raise _contradiction("its errors rise, or are not possible")
    if manifest.time_limit <= 0.0 or manifest.pixels <= 0.0 or not np.all(np.less_equal(*manifest.bounds)):
        raise _contradiction("its time limit, size in pixels or bounds are not possible")


def _falls(errors: tuple[float, ...]) -> bool:
    return all(0.0 <= last <= first <= 1.0 for first, last in zip(errors, (*errors[1:], errors[-1]), strict=True))


def _contradiction(what: str) -> FileError:
    return FileError(f"manifest.json contradicts itself: {what}; export the package again.")
