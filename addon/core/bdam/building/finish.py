"""The last step of a build: nested errors and boxes, and the files of the store."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...files.blocks import BlockWriter
from ...files.sealed_files import read_sealed
from ...geometry.placements import Frame
from ...jobs.progress import Progress, Steps
from ..store.structure import Level, StoreHeader, write_structure
from ..store.terrain_store import GEOMETRY_FILE, GEOMETRY_KIND
from ..tree import Tree
from .patch_set import EncodedPatches
from .work_folder import ADVICE, LevelLayout, WorkFolder

EDGE_POINTS = 5  # Points of each edge of a triangle that are projected: edges are curved in the local frame of a geographic grid.


def write_geometry(work: WorkFolder, layouts: list[LevelLayout], header: StoreHeader, out: Path) -> Steps[list[Level]]:
    """Write the structure and geometry files of a store to the folder `out` from the results of all tasks. Returns the levels.

    Raises:
        FileError: a file cannot be read or written.
    """
    parts: list[list[EncodedPatches]] = []
    count, done = sum(layout.count for layout in layouts), 0
    with BlockWriter(out / GEOMETRY_FILE, GEOMETRY_KIND) as writer:
        for level, layout in enumerate(layouts):
            parts.append([])
            blocks: dict[int, memoryview] = {}
            for shard in range(layout.count):
                yield Progress(done / count, "Writing the terrain")
                done += 1
                encoded = EncodedPatches.from_bytes(read_sealed(work.blocks_path(level, shard), ADVICE))
                ends = np.cumsum(encoded.sizes)
                for index, start, end in zip(encoded.indices, ends - encoded.sizes, ends, strict=True):
                    blocks[int(index)] = memoryview(encoded.blocks)[start:end]
                parts[-1].append(encoded.without_blocks())
                _write_leading(writer, blocks, layout, shard)
        checksum = writer.finish(backs_up_index=True)
    levels = _nest(work.tree, layouts, parts, header, header.create_frame())
    write_structure(out, replace(header, geometry_checksum=checksum), levels)
    return levels


def _write_leading(writer: BlockWriter, blocks: dict[int, memoryview], layout: LevelLayout, shard: int) -> None:
    """Write the blocks before the first patch of the shards to come, in ascending order, and forget them."""
    later = np.flatnonzero(layout.shards > shard)
    limit = int(layout.indices[later[0]]) if len(later) else None
    for index in sorted(index for index in blocks if limit is None or index < limit):
        writer.append(blocks.pop(index))


def _nest(tree: Tree, layouts: list[LevelLayout], parts: list[list[EncodedPatches]], header: StoreHeader, frame: Frame) -> list[Level]:
    """Return the levels with errors and boxes that include those of the finer patches in the same triangle."""
    levels: list[Level] = []
    for level in range(len(layouts) - 1, -1, -1):
        layout = layouts[level]
        indices, errors, heights, counts = (
            np.concatenate([getattr(part, name) for part in parts[level]]) for name in ("indices", "errors", "heights", "counts")
        )
        order = np.argsort(indices)
        errors, heights, counts = errors[order] * np.float32(header.height_step), heights[order], counts[order]
        low, high = _bound(tree, level, layout.indices, heights * header.height_step, frame)
        if levels:
            finer = levels[-1]
            parents = np.searchsorted(layout.indices, finer.indices >> 1)
            np.maximum.at(errors, parents, finer.errors)
            np.minimum.at(low, parents, finer.low)
            np.maximum.at(high, parents, finer.high)
        levels.append(Level(layout.indices, errors, heights, counts, low, high))
    return levels[::-1]


def _bound(tree: Tree, level: int, indices: np.ndarray, heights: np.ndarray, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest local coordinates (N, 3) float32 of patches with `heights` (N, 2) in meters, rounded outwards."""
    corners = np.minimum(tree.triangle_corners(level, indices), [tree.columns - 1, tree.rows - 1]).astype(np.float64)
    weights = np.linspace(0.0, 1.0, EDGE_POINTS, endpoint=False)[:, None]
    points = np.concatenate([corners[:, None, i] * (1.0 - weights) + corners[:, None, (i + 1) % 3] * weights for i in range(3)], axis=1)
    x, y = frame.to_local(points[..., 0], points[..., 1])
    low = np.stack([x.min(axis=1), y.min(axis=1), heights[:, 0]], axis=1)
    high = np.stack([x.max(axis=1), y.max(axis=1), heights[:, 1]], axis=1)
    return np.nextafter(low.astype(np.float32), np.float32(-np.inf)), np.nextafter(high.astype(np.float32), np.float32(np.inf))
