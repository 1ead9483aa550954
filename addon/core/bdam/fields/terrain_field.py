"""One height field from one or many elevation models."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ...errors import FileError, SettingsError
from ...files.file_access import check_readable
from ...files.segment_cache import DEFAULT_CACHE_BYTES, SegmentCache
from ...geometry.placements import Frame, Placement, create_frame
from ...heights.positions import center_scale, warn_of_stretch
from ...heights.readers import open_source
from ...heights.sources import HeightSource, ReadImage, SourceContext
from ...heights.voids import Void, find_voids, mask_voids, name_voids
from ...messages import format_count, list_first
from .mosaics import Mosaic, check_source, join

CHECK_SAMPLES = 1 << 22  # heights that are read at once when all are checked


@dataclass(frozen=True)
class FieldSettings:
    """How files without complete metadata are understood.

    cell_size: meters between two samples of a file without a position. image_height: meters between black and white of an image.
    allow_gaps: whether parts of the rectangle around several files may be missing.
    """

    cell_size: float = 1.0
    image_height: float = 100.0
    allow_gaps: bool = False


@dataclass(frozen=True, eq=False)
class TerrainField:
    """A grid of heights of any size, from one or several files.

    Grid coordinates are (x, y) = (column, row), integers at samples, row 0 in the south and column 0 in the west. The local frame is in
    meters, x east, y north, z up.

    Attributes:
        mosaic: the files.
        frame: the local frame.
        cell_size: nominal meters between two samples, the geometric mean of both directions.
        height_step: meters between two heights that the sources can tell apart; None for floats.
        warnings: sentences for the user.
    """

    mosaic: Mosaic
    frame: Frame
    cell_size: float
    height_step: float | None
    warnings: tuple[str, ...] = ()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.mosaic.shape

    @property
    def placement(self) -> Placement:
        """Where the grid lies on the map."""
        return self.mosaic.placement

    @property
    def crs(self) -> str:
        """The coordinate reference system in words."""
        return self.mosaic.placement.crs

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return the heights (h, w) float32 of a window within the grid, meters, NaN where unknown. Several threads may call it.

        Raises:
            FileError: a file is damaged or cannot be read.
        """
        return self.mosaic.read(rows, columns)


def open_field(
    paths: Iterable[Path],
    settings: FieldSettings = FieldSettings(),
    read_image: ReadImage | None = None,
    cache_bytes: int = DEFAULT_CACHE_BYTES,
) -> TerrainField:
    """Open one elevation model, or several that tile one grid, without reading their heights.

    read_image: returns the gray values (H, W) float32 of an image, row 0 at the bottom, 1 for white; None where images cannot be read.
    cache_bytes: of decoded parts of all files that stay in memory.

    Raises:
        FileError: a file is no elevation model, is damaged, rotated, too large or too small, or the files do not tile one grid.
        SettingsError: there is no file, a setting is out of range, or the files leave gaps and these are not allowed.
    """
    paths = list(paths)
    if not paths:
        raise SettingsError("The terrain needs at least one elevation model; set Sources.", ("sources",))
    for name, label in (("cell_size", "Cell Size"), ("image_height", "Image Height")):
        if not 1e-6 < getattr(settings, name) < 1e9:
            raise SettingsError(f"{label} must be positive and finite.", (name,))
    context = SourceContext(settings.cell_size, settings.image_height, read_image, SegmentCache(cache_bytes))
    sources = []
    for path in paths:
        check_readable(path)
        sources.append(check_source(open_source(path, context)))
    mosaic = join(sources, settings.allow_gaps)
    frame, cell_size = create_frame(paths[0], mosaic.placement, mosaic.shape, center_scale(mosaic.placement, mosaic.shape))
    warnings = [warning for source in sources for warning in source.warnings]
    warnings += warn_of_stretch(paths[0], mosaic.placement, mosaic.shape)
    if not mosaic.placement.is_placed:
        warnings.append(f'"{paths[0]}" has no position on a map; its cells are taken as {settings.cell_size:g} m wide (Cell Size).')
    return TerrainField(mosaic, frame, cell_size, _common_step(sources), tuple(warnings))


def check_heights(terrain: TerrainField) -> tuple[str, ...]:
    """Return warnings about the heights of a field: neighbors that differ in the samples that they have in common.

    It reads these samples, and as much of the field as it takes to find a known height. Call it once before a build; workers need not.

    Raises:
        FileError: no height is known, or a file is damaged.
    """
    if not any(np.isfinite(heights).any() for source in terrain.mosaic.sources for heights in _read_all(source)):
        names = list_first(f'"{source.path}"' for source in terrain.mosaic.sources)
        raise FileError(f"{names} contains no known height: all are marked as missing; use another file.")
    differing = 0
    for first, second, (rows, columns) in terrain.mosaic.find_common_edges():
        heights, others = (_read_part(terrain.mosaic, index, rows, columns) for index in (first, second))
        differing += int((heights != others)[np.isfinite(heights) & np.isfinite(others)].sum())
    if not differing:
        return ()
    return (f"{format_count(differing, 'height')} on common edges of neighboring files differ; those of the file named first are used.",)


def warn_of_heights(terrain: TerrainField) -> TerrainField:
    """Return the field with undeclared numbers for unknown heights as holes, with warnings of them and of `check_heights`.

    Files that do not declare such a number are read once. Raises FileError.
    """
    sources, named = [], []
    for source in terrain.mosaic.sources:
        voids = find_voids(_read_all(source), source.void_heights, source.scale)
        sources.append(replace(source, read=partial(_read_without, source, voids)) if voids else source)
        named += name_voids(source.path, voids)
    terrain = replace(terrain, mosaic=replace(terrain.mosaic, sources=tuple(sources)))
    return replace(terrain, warnings=(*terrain.warnings, *named, *check_heights(terrain)))


def _read_without(source: HeightSource, voids: list[Void], rows: slice, columns: slice) -> np.ndarray:
    return mask_voids(source.read(rows, columns), voids)


def _read_all(source: HeightSource) -> Iterator[np.ndarray]:
    """Yield the heights of a file in strips."""
    return (source.read(rows, slice(0, source.shape[1])) for rows in source.bands(CHECK_SAMPLES))


def _read_part(mosaic: Mosaic, index: int, rows: slice, columns: slice) -> np.ndarray:
    """Return heights of one source in a window of the common grid that lies within it."""
    row, column = mosaic.corners[index].tolist()
    return mosaic.sources[index].read(slice(rows.start - row, rows.stop - row), slice(columns.start - column, columns.stop - column))


def _common_step(sources: Sequence[HeightSource]) -> float | None:
    """Return the vertical step of all sources, None if they have none or different ones."""
    steps = {source.height_step for source in sources}
    return steps.pop() if len(steps) == 1 else None
