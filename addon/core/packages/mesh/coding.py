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
from collections.abc import Sequence

import numpy as np

from ..manifest import MAX_STEPS, MeshLevel, Section
from .connectivity import ConnectivityEncoder, LevelSymbols
from .order import OrderedLevel, OrderedMesh
from .positions import find_affine_weights, predict
from .sections import deflate, encode_residuals

Bounds = tuple[tuple[float, ...], tuple[float, ...]]


def quantize(values: np.ndarray, bounds: Bounds, steps: int = MAX_STEPS) -> np.ndarray:
    """Return `values` (N, D) as (N, D) uint16, 0 to `steps` from the lower to the upper bound."""
    low, high = np.array(bounds)
    extent = np.where(high > low, high - low, 1.0)
    return np.clip(np.rint((values - low) / extent * steps), 0, steps).astype(np.uint16)


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
