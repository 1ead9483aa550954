"""Meshes with levels as bytes: coarse first, quantized, predicted from neighbors, and compressed by raw DEFLATE.

Sections of a level (see `manifest.MeshLevel`), all of them raw DEFLATE:

| section | content |
|---|---|
| corners | number of symbols, uint32 little-endian; symbols; LEB128 integers of explicit vertices |
| wedges | LEB128 codes of the wedges of corners |
| parents | one symbol per added vertex; LEB128 integers of explicit parents |
| positions | 0 (predicted by parallelograms) or 1 (by texture coordinates); residuals of added vertices: first all x, then y and z |
| uvs | residuals of added wedges: first all u, then v |

The triangles of a level refer to vertices by what coarser levels are, so that a level needs all sections of coarser ones.
"""

import struct
import zlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from .connectivity_decoding import ConnectivityDecoder, LevelStreams
from .connectivity_encoding import ConnectivityEncoder, LevelSymbols
from .manifest import MAX_STEPS, MESH, Manifest, MeshLevel, Section
from .mesh_order import OrderedLevel, OrderedMesh
from .missing_positions import estimate_missing_positions
from .position_prediction import find_affine_weights, predict, reconstruct
from .sections import (
    MAX_LEB128_BYTES,
    MAX_RATIO,
    MAX_RESIDUAL_BYTES,
    IntegerReader,
    damage,
    decode_residuals,
    deflate,
    encode_residuals,
    inflate,
)

Bounds = tuple[tuple[float, ...], tuple[float, ...]]


@dataclass(frozen=True)
class DecodedLevel:
    """A level as the page shows it.

    positions: (V, 3) uint16, 0 to `Manifest.steps` within the bounds. wedge_vertices: (W,) int32. uvs: (W, 2) uint16 likewise, v downwards.
    triangles: (T, 3) int32 into wedges. materials: (T,) int32, ascending. parents: (V,) int32, -1 in the coarsest level.
    """

    positions: np.ndarray
    wedge_vertices: np.ndarray
    uvs: np.ndarray
    triangles: np.ndarray
    materials: np.ndarray
    parents: np.ndarray


def quantize(values: np.ndarray, bounds: Bounds, steps: int = MAX_STEPS) -> np.ndarray:
    """Return `values` (N, D) as (N, D) uint16, 0 to `steps` from the lower to the upper bound."""
    low, high = np.array(bounds)
    extent = np.where(high > low, high - low, 1.0)
    return np.clip(np.rint((values - low) / extent * steps), 0, steps).astype(np.uint16)


def dequantize(values: np.ndarray, bounds: Bounds, steps: int = MAX_STEPS) -> np.ndarray:
    """Return the values (N, D) float32 of `values` (N, D) uint16, as the page computes them: bit by bit the same."""
    low, high = np.array(bounds, np.float64)
    return (low + values * ((high - low) / steps)).astype(np.float32)


def encode_mesh(
    ordered: OrderedMesh, pixels: Sequence[float], material_count: int, steps: tuple[int, int] = (MAX_STEPS, MAX_STEPS)
) -> tuple[bytes, tuple[MeshLevel, ...], Bounds, Bounds]:
    """Encode all levels of a mesh.

    Args:
        pixels: see `MeshLevel`, one per level, coarsest first. material_count: larger than all materials. steps: see `Manifest`.

    Returns:
        mesh.bin, the levels of the manifest, the bounds of positions, and of texture coordinates with v downwards.
    """
    uvs = ordered.uvs * [1.0, -1.0] + [0.0, 1.0]
    bounds, uv_bounds = _find_bounds(ordered.positions), _find_bounds(uvs)
    positions, uvs = (
        values.astype(np.int64) for values in (quantize(ordered.positions, bounds, steps[0]), quantize(uvs, uv_bounds, steps[1]))
    )
    encoder = ConnectivityEncoder(ordered)
    content, levels = bytearray(), []
    for level, size in zip(ordered.levels, pixels, strict=True):
        symbols = encoder.encode(level)
        sections = []
        for packed in _pack(symbols, level, ordered.wedge_vertices, positions, uvs):
            sections.append(Section(len(content), len(packed), zlib.crc32(packed)))
            content += packed
        corners, wedges, parents, level_positions, level_uvs = sections
        counts = np.bincount(level.materials, minlength=material_count)
        levels.append(
            MeshLevel(
                vertex_count=level.vertex_count,
                wedge_count=level.wedge_count,
                triangle_counts=tuple(int(count) for count in counts),
                positions=level_positions,
                parents=parents,
                wedges=wedges,
                uvs=level_uvs,
                corners=corners,
                pixels=float(size),
            )
        )
    return bytes(content), tuple(levels), bounds, uv_bounds


def decode_level(content: bytes | memoryview, manifest: Manifest, level: int, missing_positions: Collection[int] = ()) -> DecodedLevel:
    """Decode `level` of `content`, mesh.bin, of which only the sections of this level and of coarser ones are read.

    Args:
        missing_positions: levels whose positions have not come; theirs and those of finer levels are estimated.

    Raises:
        FileError: the mesh is damaged, or contradicts the manifest.
    """
    decoder = ConnectivityDecoder()
    positions, uvs = [[], [], []], [[], []]
    is_exact = True
    for index, item in enumerate(manifest.levels[: level + 1]):
        known, known_wedges = len(positions[0]), len(uvs[0])
        added, added_wedges = item.vertex_count - known, item.wedge_count - known_wedges
        if not 0 <= added <= added_wedges:
            raise damage()
        uv_part = inflate(item.uvs.read(content, MESH), 2 * MAX_RESIDUAL_BYTES * added_wedges)
        uv_residuals = decode_residuals(uv_part, added_wedges, 2)
        decoder.decode(_read_streams(content, item, added), item.triangle_counts, item.vertex_count)
        if len(decoder.wedge_vertices) != item.wedge_count:
            raise damage()
        reconstruct(uvs, uv_residuals, decoder.wedge_references, None)
        triangles, wedge_vertices = np.array(decoder.triangles, np.int64).reshape(-1, 3), np.array(decoder.wedge_vertices, np.int64)
        neighborhood = (triangles, wedge_vertices, np.array(uvs, np.int64).T, known, item.vertex_count)
        is_exact = is_exact and index not in missing_positions
        if not is_exact:
            parents = np.array(decoder.parents[known:], np.int64)
            estimated = estimate_missing_positions(find_affine_weights(*neighborhood, True), np.array(positions).T, parents)
            for column, values in zip(positions, estimated.T.tolist(), strict=True):
                column.extend(values)
            continue
        part = inflate(item.positions.read(content, MESH), 1 + 3 * MAX_RESIDUAL_BYTES * added)
        affine = find_affine_weights(*neighborhood) if part[:1] == b"\1" else None
        reconstruct(positions, decode_residuals(part[1:], added, 3), decoder.vertex_references, affine)
    counts = manifest.levels[level].triangle_counts
    return DecodedLevel(
        positions=np.array(positions, np.uint16).T,
        wedge_vertices=wedge_vertices.astype(np.int32),
        uvs=np.array(uvs, np.uint16).T,
        triangles=triangles.astype(np.int32),
        materials=np.repeat(np.arange(len(counts), dtype=np.int32), counts),
        parents=np.array(decoder.parents, np.int32),
    )


def _find_bounds(values: np.ndarray) -> Bounds:
    return tuple(values.min(axis=0).tolist()), tuple(values.max(axis=0).tolist())


def _pack(symbols: LevelSymbols, level: OrderedLevel, wedge_vertices: np.ndarray, positions: np.ndarray, uvs: np.ndarray) -> list[bytes]:
    """Return the sections corners, wedges, parents, positions and uvs, compressed."""
    known_count = level.vertex_count - len(symbols.vertex_references)
    parallelograms = _add_references(positions, symbols.vertex_references, known_count)
    affine = find_affine_weights(level.triangles, wedge_vertices[: level.wedge_count], uvs, known_count, level.vertex_count)
    added = positions[known_count : level.vertex_count]
    candidates = [parallelograms, predict(affine, positions, parallelograms)]
    packed_positions = []
    for kind, values in enumerate(candidates):
        residual_symbols, bits = encode_residuals(added - values)
        packed_positions.append(deflate(bytes([kind]) + residual_symbols, bits))
    known_wedges = level.wedge_count - len(symbols.wedge_references)
    uv_residuals = uvs[known_wedges : level.wedge_count] - _add_references(uvs, symbols.wedge_references, known_wedges)
    return [
        deflate(struct.pack("<I", len(symbols.symbols)) + symbols.symbols, symbols.vertices),
        deflate(symbols.wedges),
        deflate(symbols.parent_symbols, symbols.parents),
        min(packed_positions, key=len),
        deflate(*encode_residuals(uv_residuals)),
    ]


def _add_references(values: np.ndarray, references: np.ndarray, known_count: int) -> np.ndarray:
    """Return first + second - third of `values` (M, D) by `references` (N, 3), 0 for the very first one, which refers to itself."""
    first, second, third = references.T
    prediction = values[first] + values[second] - values[third]
    if known_count == 0:
        prediction[:1] = 0
    return prediction


def _read_streams(content: bytes | memoryview, level: MeshLevel, added: int) -> LevelStreams:
    """Return the code of the triangles of `level`, which adds so many vertices."""
    triangle_count = sum(level.triangle_counts)
    _check_size(triangle_count, level.corners)
    size = 3 * triangle_count
    corners = inflate(level.corners.read(content, MESH), 4 + size * (1 + MAX_LEB128_BYTES))
    if len(corners) < 4:
        raise damage()
    symbol_count = struct.unpack_from("<I", corners)[0]
    codes = inflate(level.wedges.read(content, MESH), size * MAX_LEB128_BYTES)
    parents = inflate(level.parents.read(content, MESH), added * (1 + MAX_LEB128_BYTES))
    parent_count = added if parents else 0
    if 4 + symbol_count > len(corners) or len(parents) < parent_count:
        raise damage()
    return LevelStreams(
        symbols=corners[4 : 4 + symbol_count],
        vertices=IntegerReader(corners, 4 + symbol_count),
        wedges=IntegerReader(codes, 0),
        parent_symbols=parents[:parent_count],
        parents=IntegerReader(parents, parent_count),
    )


def _check_size(count: int, section: Section) -> None:
    """Raise FileError if `section` is too small for at least one byte for each of `count` items, before anything is allocated for them."""
    if count > MAX_RATIO * section.size:
        raise damage()
