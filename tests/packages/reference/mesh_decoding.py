"""Levels from mesh.bin, as the page decodes them: the inverse of `core.packages.mesh.coding`.

Positions whose bytes are missing are estimated (section VI of the paper). The paper estimates a lost vertex from its texel, which came in
another packet, and from features before and after it in the queue. Here an added vertex begins at its parent. Then, some times, each moves
to where the affine function from texture coordinates to positions that fits its neighbors best puts its own texel. After few passes that is
several times nearer than the parent.
"""

import math
import struct
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from reference.connectivity_decoding import ConnectivityDecoder, LevelStreams
from reference.sections import MAX_LEB128_BYTES, MAX_RATIO, MAX_RESIDUAL_BYTES, IntegerReader, damage, decode_residuals, inflate

from farfield.addon.core.packages.manifest import MAX_STEPS, MESH, Manifest, MeshLevel, Section
from farfield.addon.core.packages.mesh.coding import Bounds
from farfield.addon.core.packages.mesh.positions import MAX_VALUE, AffineWeights, find_affine_weights

PASSES = 5


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


def dequantize(values: np.ndarray, bounds: Bounds, steps: int = MAX_STEPS) -> np.ndarray:
    """Return the values (N, D) float32 of `values` (N, D) uint16, as the page computes them: bit by bit the same."""
    low, high = np.array(bounds, np.float64)
    return (low + values * ((high - low) / steps)).astype(np.float32)


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


def reconstruct(
    columns: list[list[int]], residuals: np.ndarray, references: list[tuple[int, int, int]], affine: AffineWeights | None
) -> None:
    """Append values to `columns`: predictions by `affine`, by parallelograms where it is not valid or None, plus `residuals` (N, D).

    references: (N, 3), see `LevelSymbols`.
    """
    if affine is not None:
        starts, neighbors, weights, is_valid = (values.tolist() for values in vars(affine).values())
    for values, column in zip(columns, residuals.T.tolist(), strict=True):
        for row, ((first, second, third), residual) in enumerate(zip(references, column, strict=True)):
            if affine is not None and is_valid[row]:
                total = 0.0
                for slot in range(starts[row], starts[row + 1]):
                    total += weights[slot] * values[neighbors[slot]]
                value = math.floor(total + 0.5) + residual
            elif first == len(values):  # the very first one
                value = residual
            else:
                value = values[first] + values[second] - values[third] + residual
            values.append(value & MAX_VALUE)


def estimate_missing_positions(affine: AffineWeights, positions: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Return estimated positions (N, 3) int64 of the vertices that a level adds.

    Args:
        affine: of all neighbors of the added vertices, those of larger number included. positions: (V, 3) integers, 0 to 65535, of the
            coarser levels. parents: (N,), into those; -1 in the coarsest level.
    """
    added = positions[parents] if len(positions) else np.full((len(parents), 3), (MAX_VALUE + 1) / 2)
    owners = np.repeat(np.arange(len(parents)), np.diff(affine.starts))
    current = np.concatenate([positions, added]).astype(np.float64)
    for _ in range(PASSES):
        columns = [np.bincount(owners, affine.weights * column, len(parents)) for column in current[affine.neighbors].T]
        current[len(positions) :] = np.stack(columns, axis=1)
    return np.clip(np.floor(current[len(positions) :] + 0.5), 0, MAX_VALUE).astype(np.int64)


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
