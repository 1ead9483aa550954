"""Textures as the paper sends them: JPEG files of small fragments, whose quality follows the number of features (section III.C).

For comparison, and for Figures 7 and 9. Fragments are row by row from the top left corner.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.imaging.coded_images import decode, encode
from farfield.addon.core.packages.textures.texture_tiles import TileGrid, cut_tiles, join_tiles
from farfield.addon.core.texmesh.scale_space.features import SCALES
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

FRAGMENT_UNIT = 16  # pixels; macroblocks of JPEG
DEFAULT_FRAGMENT = 32
DEFAULT_TOLERANCE = 20.0  # Deviation of qualities from that of a scale.
MAX_QUALITY = 100
UNFRAGMENTED_QUALITY = 100  # Quality of the file of the image that is put together from fragments, "without further compression".


@dataclass(frozen=True, eq=False)
class FragmentMap:
    """The fragment map: how many features of each scale lie in each fragment, (SCALES, rows, columns) int64."""

    grid: TileGrid
    counts: np.ndarray


class SizeTable(NamedTuple):
    """Bytes against the threshold of a scale: thresholds (N,), qualities (N, rows, columns) int64 and bytes (N,) int64 of all fragments."""

    thresholds: np.ndarray
    qualities: np.ndarray
    byte_counts: np.ndarray


class FragmentationRow(NamedTuple):
    """A row of Figure 7: bytes of all fragments, of one file of the same pixels, and of the image as one file of the same quality."""

    quality: int
    fragmented: int
    non_fragmented: int
    single: int


def make_fragment_grid(width: int, height: int, side: int = DEFAULT_FRAGMENT) -> TileGrid:
    """Return how a texture is divided into fragments of `side` pixels.

    Raises:
        SettingsError: `side` is no multiple of 16.
    """
    if side < FRAGMENT_UNIT or side % FRAGMENT_UNIT:
        raise SettingsError(f"The side of fragments must be a multiple of {FRAGMENT_UNIT} pixels, not {side}.")
    return TileGrid(width, height, side)


def count_features(mesh: TexturedMesh, materials: Sequence[int], last_scales: np.ndarray, grid: TileGrid) -> FragmentMap:
    """Distribute the features of all scales onto fragments by the texel of each vertex, that of its first wedge.

    Args:
        materials: those that use the texture. last_scales: (V,), see `ScaleMap`.
    """
    uses = np.zeros(len(mesh.uvs), bool)
    uses[mesh.wedge_triangles[np.isin(mesh.materials, materials)]] = True
    wedges = np.flatnonzero(uses)
    vertices, first = np.unique(mesh.wedge_vertices[wedges], return_index=True)
    uvs = mesh.uvs[wedges[first]] * [1.0, -1.0] + [0.0, 1.0]
    size = np.array([grid.width, grid.height])
    inside = np.where((uvs < 0.0) | (uvs > 1.0), uvs % 1.0, uvs)  # 1 is the last texel
    columns, rows = np.minimum((inside * size).astype(np.int64), size - 1).T // grid.tile_size
    scales = last_scales[vertices].astype(np.int64)
    index = (scales * grid.rows + rows) * grid.columns + columns
    by_last = np.bincount(index, minlength=SCALES * grid.rows * grid.columns).reshape(SCALES, grid.rows, grid.columns)
    return FragmentMap(grid, by_last[::-1].cumsum(axis=0)[::-1])


def normalize_counts(counts: np.ndarray) -> np.ndarray:
    """Return the distribution of features, 0 to 1, of `counts` (rows, columns) of a scale (equation 6); 0 where all are equal."""
    low, high = counts.min(), counts.max()
    return (counts - low) / (high - low) if high > low else np.zeros(counts.shape)


def quality_of_scale(scale: int, scale_count: int = SCALES) -> float:
    """Return the default quality of a scale: from 100 at scale 0 linearly to 0 at the last one."""
    return MAX_QUALITY * (1.0 - scale / (scale_count - 1))


def assign_qualities(
    distribution: np.ndarray, quality: float, threshold: float | None = None, tolerance: float = DEFAULT_TOLERANCE
) -> np.ndarray:
    """Return the quality, 0 to 100, of fragments with a `distribution` (rows, columns) of features.

    threshold: the distribution of fragments with the default `quality`, the mean for None. tolerance: the largest deviation from it.
    """
    center = float(distribution.mean()) if threshold is None else threshold
    qualities = quality + (distribution - center) * tolerance
    return np.clip(np.clip(qualities, quality - tolerance, quality + tolerance), 0.0, MAX_QUALITY)


class CodedFragments:
    """The fragments of an image (H, W, 3) uint8, row 0 at the bottom, coded when they are needed."""

    def __init__(self, image: np.ndarray, grid: TileGrid) -> None:
        self.grid = grid
        rows, columns = grid.padded_shape
        padded = np.pad(image[::-1], ((0, rows - grid.height), (0, columns - grid.width), (0, 0)), mode="edge")
        self._fragments = cut_tiles(padded, grid.tile_size)
        self._files: dict[tuple[int, int], bytes] = {}

    def code(self, qualities: np.ndarray) -> list[bytes]:
        """Return the files of all fragments with `qualities` (rows, columns) of 0 to 100; JPEG has none below 1."""
        rounded = np.clip(np.rint(qualities), 1, MAX_QUALITY).astype(np.int64).ravel().tolist()
        return [self._code(index, quality) for index, quality in enumerate(rounded)]

    def decode(self, files: Sequence[bytes]) -> np.ndarray:
        """Return the image (H, W, 3) uint8, row 0 at the bottom, of the files of all fragments."""
        return join_tiles(np.stack([decode(file)[::-1] for file in files]), self.grid)[::-1]

    def _code(self, index: int, quality: int) -> bytes:
        key = index, quality
        if key not in self._files:
            self._files[key] = encode(self._fragments[index][::-1], "jpeg", quality)
        return self._files[key]


def tabulate_sizes(
    fragments: CodedFragments,
    feature_map: FragmentMap,
    scale: int,
    thresholds: np.ndarray,
    tolerance: float = DEFAULT_TOLERANCE,
) -> SizeTable:
    """Return the lookup table of a scale: the bytes of all fragments against the threshold. More bytes never come from a higher one, as far
    as those of a fragment rise with its quality."""
    distribution = normalize_counts(feature_map.counts[scale])
    qualities = [assign_qualities(distribution, quality_of_scale(scale), float(threshold), tolerance) for threshold in thresholds]
    byte_counts = np.array([sum(map(len, fragments.code(item))) for item in qualities], np.int64)
    return SizeTable(thresholds, np.clip(np.rint(qualities), 1, MAX_QUALITY).astype(np.int64), byte_counts)


def measure_fragmentation(image: np.ndarray, qualities: Sequence[int], side: int = FRAGMENT_UNIT) -> list[FragmentationRow]:
    """Return Figure 7 for an image (H, W, 3) uint8, row 0 at the bottom, with fragments of `side` pixels.

    As in the paper, the non-fragmented file is that of the image put together from the coded fragments, without further compression. A file
    of the image itself, with the quality of the fragments, is what fragments compete with.
    """
    grid = make_fragment_grid(image.shape[1], image.shape[0], side)
    fragments = CodedFragments(image, grid)
    rows = []
    for quality in qualities:
        files = fragments.code(np.full((grid.rows, grid.columns), quality))
        joined = encode(fragments.decode(files), "jpeg", UNFRAGMENTED_QUALITY)
        rows.append(FragmentationRow(quality, sum(map(len, files)), len(joined), len(encode(image, "jpeg", quality))))
    return rows


def measure_quality_sizes(image: np.ndarray, qualities: Sequence[int], side: int = DEFAULT_FRAGMENT) -> np.ndarray:
    """Return Figure 9 for an image (H, W, 3) uint8: the mean bytes (N,) of a fragment of `side` pixels against `qualities` (N,)."""
    grid = make_fragment_grid(image.shape[1], image.shape[0], side)
    fragments = CodedFragments(image, grid)
    return np.array([np.mean([len(file) for file in fragments.code(np.full((grid.rows, grid.columns), item))]) for item in qualities])
