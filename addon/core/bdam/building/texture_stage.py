"""The textures and normal maps of a build: what is built from which images, in tasks from the finest level to the coarsest, and these
tasks."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from ...files.file_access import convert_os_errors
from ...files.sealed_files import read_sealed, write_sealed
from ...files.segment_cache import SegmentCache
from ...jobs.progress import Progress, Steps, subprogress
from ...jobs.task_pool import TaskPool
from ..fields.terrain_field import TerrainField
from ..settings import BdamSettings
from ..store.structure import StoreHeader
from ..store.terrain_store import NORMALS_FOLDER, TEXTURE_FOLDER
from ..textures.build import build_tiles, discard_pieces, list_tiles, missing_tiles
from ..textures.grid import MAX_COARSER, TextureGrid, count_levels
from ..textures.plan import TexturePlan, check_plan, parse_plan
from ..textures.resampling import ImageSource, PlacedImage
from ..textures.store import write_textures
from ..tree import Tree
from .ground_images import GroundImage, decode_image, open_image, place_images
from .height_grid import HeightGrid
from .sample_normals import SampleNormals
from .work_folder import ADVICE, WorkFolder

TILES_PER_TASK = 8
TEXTURE_TASK = "texture"  # first element of the items of these tasks
CACHE_BYTES = 48 << 20  # bytes of decoded parts of TIFF files that a worker keeps


@dataclass(frozen=True)
class TextureWork:
    """The textures or the normal maps of a build.

    Attributes:
        plan: what is built.
        images: of textures; later ones lie over earlier ones.
        name: of the folders with the tiles, in the work folder and in the store.
    """

    plan: TexturePlan
    images: tuple[GroundImage, ...] = ()
    name: str = TEXTURE_FOLDER

    @property
    def texels(self) -> int:
        """The number of texels of the finest level."""
        return int(np.prod(self.plan.grid.texel_counts(self.plan.grid.level_count - 1)))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences for the user."""
        grid = self.plan.grid
        texel = grid.texel(grid.level_count - 1)
        known = tuple(warning for image in self.images for warning in image.warnings)
        finer = [image for image in self.images if min(map(abs, image.step)) * (1.0 + MAX_COARSER) < texel]
        if not finer:
            return known
        pixel, meters = min(map(abs, finer[0].step)) * max(grid.spacing), grid.texel_meters(grid.level_count - 1)
        sizes = f"pixels of {pixel:.3g} m, finer than the smallest texels of {meters:.3g} m"
        return (*known, f'"{finer[0].path}" has {sizes}; choose a smaller Patch Size for finer texels.')


def plan_maps(field: TerrainField, tree: Tree, paths: Sequence[Path], settings: BdamSettings) -> tuple[TextureWork, ...]:
    """Return the textures to build from the images `paths`, if there are any, and the normal maps, if they are wanted.

    Raises:
        FileError: see `place_images`.
    """
    textures = (_plan_textures(field, tree, paths, settings),) if paths else ()
    return (*textures, _plan_normals(field, tree)) if has_normal_maps(settings) else textures


def has_normal_maps(settings: BdamSettings) -> bool:
    """Return whether normal maps are wanted and can be coded: Farfield also runs without Pillow."""
    return settings.normal_maps and find_spec("PIL") is not None


def _plan_textures(field: TerrainField, tree: Tree, paths: Sequence[Path], settings: BdamSettings) -> TextureWork:
    images = place_images(paths, field.placement, field.shape)
    pixel = min(min(map(abs, image.step)) for image in images)
    level_count = count_levels(tree.side, tree.depth, pixel)
    grid = TextureGrid(tree.columns, tree.rows, tree.side, _measure_cell(field), level_count)
    plan = TexturePlan(grid, settings.texture_format, settings.texture_quality or None, settings.texture_error)
    check_plan(plan)
    return TextureWork(plan, tuple(images))


def _plan_normals(field: TerrainField, tree: Tree) -> TextureWork:
    """Return normal maps with a texel per sample."""
    grid = TextureGrid(tree.columns, tree.rows, tree.side, _measure_cell(field), count_levels(tree.side, tree.depth, 1.0))
    return TextureWork(TexturePlan(grid, "lossless"), name=NORMALS_FOLDER)


def decode_images(textures: TextureWork, work: WorkFolder) -> Steps[None]:
    """Decode the images that workers cannot read in parts, unless all tiles of the finest level are built.

    Raises:
        FileError: an image or a file cannot be read or written.
    """
    grid = textures.plan.grid
    if len(missing_tiles(work.path / textures.name, grid, grid.level_count - 1)):
        for index, image in enumerate(textures.images):
            yield Progress(index / len(textures.images), "Decoding images")
            decode_image(image, work.path)


def build_texture_tiles(textures: TextureWork, header: StoreHeader, work: WorkFolder, pool: TaskPool, has_holes: bool) -> Steps[None]:
    """Build all tiles from decoded images or from the heights of the store with a header; goes on with what an interrupted build has left.

    has_holes: whether texels where heights are unknown become transparent.

    Raises:
        FarfieldError: a file cannot be read or written, or a worker fails.
    """
    folder, grid = work.path / textures.name, textures.plan.grid
    with convert_os_errors(f'"{folder}" cannot be created'):
        folder.mkdir(exist_ok=True)
    finest = grid.level_count - 1
    content = {"plan": textures.plan.to_json().decode(), "images": [asdict(image) for image in textures.images], "has_holes": has_holes}
    content["header"] = asdict(header)
    write_sealed(_tasks_path(work, textures.name), json.dumps(content, sort_keys=True).encode())
    counts = [len(list_tiles(grid, level)) for level in range(grid.level_count)]
    total, done = sum(counts), 0
    for level in range(finest, -1, -1):
        missing = missing_tiles(folder, grid, level).tolist()
        start = (done + counts[level] - len(missing)) / total
        done += counts[level]
        items = [
            [TEXTURE_TASK, textures.name, level, missing[first : first + TILES_PER_TASK]]
            for first in range(0, len(missing), TILES_PER_TASK)
        ]
        if items:
            yield from subprogress(pool.run(items, f"{textures.name.capitalize()}, level {level} of {finest}"), start, done / total)
        discard_pieces(folder, level + 1)
    for image in textures.images:
        if image.raw is not None:
            with convert_os_errors(f'A file in "{work.path}" cannot be deleted'):
                (work.path / image.raw).unlink(missing_ok=True)


def write_texture_store(textures: TextureWork, work: WorkFolder, store: Path) -> Steps[int]:
    """Write the tiles to the folder of a store; return their number. Raises FileError."""
    out = store / textures.name
    with convert_os_errors(f'"{out}" cannot be created'):
        out.mkdir()
    return (yield from write_textures(work.path / textures.name, textures.plan, out))


def _tasks_path(work: WorkFolder, name: str) -> Path:
    """Return the path of the file that tells workers what they build."""
    return work.path / f"{name}.json"


def _measure_cell(field: TerrainField) -> tuple[float, float]:
    """Return the meters between neighboring samples along x and y at the center of a field."""
    x, y = ((count - 1) / 2.0 for count in field.shape[::-1])
    east, north = field.frame.to_local(np.array([x, x + 1.0, x]), np.array([y, y, y + 1.0]))
    return tuple(float(np.hypot(east[index] - east[0], north[index] - north[0])) for index in (1, 2))


class KnownSamples:
    """An image source: a pixel per sample of a field, (rows, columns, 4) uint8, whose alpha is 0 where the height is unknown, else 255."""

    def __init__(self, grid: HeightGrid) -> None:
        self.shape, self._grid = (grid.rows, grid.columns, 4), grid

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return a window (h, w, 4) uint8. Raises FileError."""
        _, is_known = self._grid.read(rows, columns)
        pixels = np.zeros((*is_known.shape, 4), np.uint8)
        pixels[..., 3] = np.where(is_known, 255, 0)
        return pixels


class TextureTasks:
    """Builds texture tiles of a build in its work folder."""

    def __init__(self, folder: WorkFolder) -> None:
        self._folder = folder
        self._read_work = cache(self._read_work_file)

    def run(self, name: str, level: int, tiles: Sequence[Sequence[int]]) -> None:
        """Build the tiles [i, j] of a level of the quadtree `name`; all tiles of the finer level must be built.

        Raises:
            FileError: an image cannot be read, or a file cannot be written.
        """
        plan, images, mask = self._read_work(name)
        build_tiles(self._folder.path / name, plan, level, np.array(tiles), images, mask)

    def _read_work_file(self, name: str) -> tuple[TexturePlan, list[PlacedImage], PlacedImage | None]:
        """Return the plan, the images, and the mask of known heights, None where all are known or do not matter."""
        content, grid = json.loads(read_sealed(_tasks_path(self._folder, name), ADVICE)), self._folder.grid
        plan = parse_plan(content["plan"].encode())
        if name == NORMALS_FOLDER:
            header = StoreHeader(**content["header"])
            return plan, [_place_samples(SampleNormals(grid, header.create_frame(), header.height_step))], None
        segments = SegmentCache(CACHE_BYTES)
        images = [open_image(GroundImage.from_json(image), self._folder.path, segments) for image in content["images"]]
        return plan, images, _place_samples(KnownSamples(grid)) if content["has_holes"] else None


def _place_samples(source: ImageSource) -> PlacedImage:
    """Return an image with a pixel per sample on its field."""
    return PlacedImage(source, (-0.5, -0.5), (1.0, 1.0))
