"""Images of the ground: where they lie on a field, and their pixels by window, as the tasks of a build need them.

GeoTIFF files are read by window from where they are. JPEG, PNG and WebP files cannot be: the parent process decodes them once into raw
files in the work folder, which workers read by window without mapping them.

The position of an image without tags may be in a world file (`heights.positions`), which does not declare the coordinate reference system.
An image in another one is warped, if both are degrees, UTM or Web Mercator.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileError, ImageError
from ...files.atomic_write import TEMPORARY_SUFFIX
from ...files.file_access import check_readable, convert_os_errors
from ...files.geotiff import GeoReference
from ...files.segment_cache import SegmentCache
from ...files.tiffs import TiffImage, open_tiff
from ...geometry.placements import Placement
from ...geometry.reprojection import find_projection
from ...heights.positions import Position, complete_georeference, find_position
from ...imaging.coded_images import read_coded_image, read_coded_shape
from ..textures.resampling import PlacedImage
from .height_grid import read_window
from .tiff_colors import TiffColors, check_colors
from .warped_images import Warp, WarpedPixels, plan_warp

Numbers = tuple[float, float]
Axes = tuple[Numbers, Numbers]  # the outer corner of the first pixel, and the steps along x and y
TIFF_EXTENSIONS, CODED_EXTENSIONS = (".tif", ".tiff"), (".jpg", ".jpeg", ".png", ".webp")


@dataclass(frozen=True)
class GroundImage:
    """An image file and its place on the field. It consists of types of JSON, for the tasks of a build.

    Attributes:
        path: absolute path.
        raw: name in the work folder of the file with the decoded pixels, None for TIFF files.
        shape: rows, columns, channels.
        corner, step: position on the field, see `PlacedImage`.
        warp: how an image in another projection lies there, None for all others; corner and step are those of its grid.
        warnings: sentences for the user.
    """

    path: str
    raw: str | None
    shape: tuple[int, int, int]
    corner: tuple[float, float]
    step: tuple[float, float]
    warp: Warp | None = None
    warnings: tuple[str, ...] = ()

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> "GroundImage":
        """Return an image from its fields, as `dataclasses.asdict` and JSON give them."""
        return cls(**values | {"warp": None if values["warp"] is None else Warp.from_json(values["warp"])})

    @property
    def raw_bytes(self) -> int:
        """The size of the raw file, 0 for TIFF files."""
        return int(np.prod(self.shape)) if self.raw else 0


class RawPixels:
    """An image source: a file with bytes (H, W, C) row by row."""

    def __init__(self, path: Path, shape: tuple[int, int, int]) -> None:
        self.shape, self._path = shape, path

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return a window (h, w, C) uint8. Raises FileError."""
        window = np.ascontiguousarray(read_window(self._path, np.dtype((np.void, self.shape[2])), self.shape[1], rows, columns))
        return window.view(np.uint8).reshape(*window.shape, self.shape[2])


def place_images(paths: Sequence[Path], field: Placement, shape: tuple[int, int]) -> list[GroundImage]:
    """Find where image files lie on a field with rows and columns `shape`. Only their headers are read.

    An image in another coordinate reference system than the field is warped; that of a world file is taken to be the same. A single image
    without a position is stretched over the whole field.

    Raises:
        FileError: an image cannot be read, is rotated, lies elsewhere or in a coordinate reference system that cannot be warped to that of
            the field, or one of several images has no position.
    """
    return [_place_image(path, index, len(paths) == 1, field, shape) for index, path in enumerate(paths)]


def decode_image(image: GroundImage, folder: Path) -> None:
    """Decode an image into its raw file in `folder`, unless it is a TIFF file or that was done before.

    Raises:
        FileError: the image is damaged or has changed, or the file cannot be written.
    """
    if image.raw is None:
        return
    path = folder / image.raw
    if path.is_file() and path.stat().st_size == image.raw_bytes:
        return
    with _convert_image_errors(Path(image.path)):
        pixels = read_coded_image(Path(image.path))
    if pixels.shape != tuple(image.shape):
        raise FileError(f'"{image.path}" has changed since the build began; start the build again.')
    temporary = path.with_name(path.name + TEMPORARY_SUFFIX)
    with convert_os_errors(f'Cannot write "{path}"'):
        pixels.tofile(temporary)
        temporary.replace(path)


def open_image(image: GroundImage, folder: Path, cache: SegmentCache) -> PlacedImage:
    """Open an image for a task. folder: the work folder. cache: keeps decoded parts of TIFF files.

    Raises:
        FileError: it cannot be read.
    """
    if image.raw is not None:
        source = RawPixels(folder / image.raw, tuple(image.shape))
    else:
        source = TiffColors(_open_color_tiff(Path(image.path)), cache)
    if image.warp is not None:
        source = WarpedPixels(source, image.warp)
    return PlacedImage(source, tuple(image.corner), tuple(image.step))


def _place_image(path: Path, index: int, is_single: bool, field: Placement, shape: tuple[int, int]) -> GroundImage:
    check_readable(path)
    extension = path.suffix.lower()
    reference, raw, warnings = GeoReference(), None, ()
    if extension in TIFF_EXTENSIONS:
        tiff = _open_color_tiff(path)
        size = *tiff.shape, TiffColors.count_channels(tiff)
        reference, warnings = tiff.georeference, tiff.warnings
    elif extension in CODED_EXTENSIONS:
        raw = f"image-{index:04d}.raw"
        with _convert_image_errors(path):
            size = read_coded_shape(path)
    else:
        endings = ", ".join((*TIFF_EXTENSIONS, *CODED_EXTENSIONS))
        raise FileError(f'"{path}" cannot be used as a texture; its name must end in one of {endings}.')
    completed = complete_georeference(path, reference)
    position, warp = find_position(path, completed, size[:2], 1.0), None
    if position.placement.is_placed:
        is_declared = reference.affine is not None or completed.has_unit or position.placement.is_geographic
        axes = _find_axes(position, size[:2], is_reversed=raw is not None)
        corner, step, warp = _place_on_map(path, position.placement, axes, is_declared, size[:2], field, shape)
        if warp is not None:
            warnings = (*warnings, f'"{path}" is warped from {position.placement.crs} to {field.crs}.')
    elif is_single:
        height = float(shape[0] - 1)
        corner, step = (0.0, 0.0 if raw else height), ((shape[1] - 1) / size[1], (height if raw else -height) / size[0])
    else:
        raise FileError(f'"{path}" has no position, so it cannot be joined with other images; add a world file, or use a GeoTIFF.')
    return GroundImage(str(path.absolute()), raw, size, corner, step, warp, warnings)


def _find_axes(position: Position, size: tuple[int, int], is_reversed: bool) -> Axes:
    """Return the outer corner of pixel (row 0, column 0) and the steps of an image with rows and columns `size` on its map.

    is_reversed: whether rows are read from the last one of the file on.
    """
    first, step = position.placement.first, position.placement.step
    corner = first[0] - 0.5 * step[0], first[1] - 0.5 * step[1]
    if position.is_south_up != is_reversed:
        return corner, step
    return (corner[0], corner[1] + step[1] * size[0]), (step[0], -step[1])


def _place_on_map(
    path: Path, placement: Placement, axes: Axes, is_declared: bool, size: tuple[int, int], field: Placement, shape: tuple[int, int]
) -> tuple[Numbers, Numbers, Warp | None]:
    """Return the outer corner of the first pixel and the steps of an image in grid coordinates of the field, and how it is warped.

    is_declared: whether the image has a coordinate reference system of its own.
    """
    if not field.is_placed:
        raise FileError(f'"{path}" has a position on a map but the elevation model has none; use an elevation model with a position.')
    projections, warp = (find_projection(placement), find_projection(field)), None
    if is_declared and placement.has_other_crs(field) and (None in projections or projections[0] != projections[1]):
        if None in projections:
            raise FileError(
                f'"{path}" and the elevation model have different projections ({placement.crs} and {field.crs}), not both of which are '
                "degrees, UTM or Web Mercator; warp the image to that of the elevation model."
            )
        warp = plan_warp(placement, *axes, size, field, shape)
        if warp is not None:
            return warp.corner, warp.step, warp
    else:
        (west, y), step = axes
        if field.is_geographic:
            center = field.position((shape[1] - 1) / 2.0, 0.0)[0]
            west -= 360.0 * round((west + 0.5 * step[0] * size[1] - center) / 360.0)
        corner = (west - field.first[0]) / field.step[0], (y - field.first[1]) / field.step[1]
        step = step[0] / field.step[0], step[1] / field.step[1]
        ends = corner[0] + step[0] * size[1], corner[1] + step[1] * size[0]
        if all(min(corner[axis], ends[axis]) < shape[1 - axis] - 1 and max(corner[axis], ends[axis]) > 0.0 for axis in range(2)):
            return corner, step, None
    raise FileError(f'"{path}" lies outside of the elevation model; check its position, or leave it out.')


def _open_color_tiff(path: Path) -> TiffImage:
    tiff = open_tiff(path)
    check_colors(tiff)
    return tiff


@contextmanager
def _convert_image_errors(path: Path) -> Iterator[None]:
    """Raise a FileError that names the whole path instead of an ImageError or an OSError in the block."""
    try:
        with convert_os_errors(f'"{path}" cannot be read'):
            yield
    except ImageError as error:
        raise FileError(f'"{path}" cannot be used as a texture: {error}') from error
