"""The build of a terrain: heights, textures, patches level by level from the finest to the coarsest, and the store (BDAM, 5)."""

import hashlib
import json
import shutil
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from ...errors import FarfieldError, FileError
from ...files.atomic_write import TEMPORARY_SUFFIX
from ...files.file_access import convert_os_errors, folder_bytes
from ...files.sealed_files import read_sealed, validate_or_remove, write_sealed
from ...geometry.placements import GeographicFrame
from ...jobs.executors import Executor, parse_executor
from ...jobs.heartbeat import take_over
from ...jobs.job_folder import open_job_folder, remove_temporary_files
from ...jobs.progress import Progress, StageClock, Steps, subprogress
from ...jobs.task_pool import TaskPool
from ...messages import format_bytes
from ..fields.terrain_field import TerrainField
from ..settings import BdamSettings
from ..store.structure import Level, StoreHeader
from ..store.terrain_store import TEXTURE_FOLDER
from .erosion import erode_heights
from .finish import write_geometry
from .height_grid import HeightGrid
from .heights import choose_height_step, fill_holes, write_heights
from .store_target import check_target, delete_work_folder, recover_store, replace_store, work_folder_path
from .texture_stage import TextureWork, build_texture_tiles, decode_images, has_normal_maps, plan_maps, write_texture_store
from .voids import VoidCounts, count_voids, fill_small_voids
from .work_folder import ADVICE, PARAMETERS_FILE, BuildParameters, LevelLayout, WorkFolder

TASKS_MODULE = "addon.core.bdam.building.tasks"
FORMAT_VERSION = 7  # version of the files in a work folder
VOIDS_FILE = "heights.voids"  # the counts of voids
FILLED_FILE = "heights.filled"  # marks that voids were filled
SOURCE_HEIGHTS_FILE = "source-heights.raw"  # the heights before erosion
DIAMONDS_PER_SHARD = {16: 96, 32: 24, 64: 6}  # by cells of a leaf: as many samples; workers need up to 240 MB
GRADIENT_STEP = 1.0 / 64.0  # meters of height per meter
READ_END, FINISH_START = 0.05, 0.95  # progress at which heights are read, and at which the store is written
EROSION_END = 0.25  # progress at which heights are eroded, if they are
TEXEL_COST = 0.05  # seconds of a texel relative to those of a sample, for the progress
HEIGHT_BYTES = 4.0  # per sample, in the work folder
EROSION_BYTES = 8.0  # per sample, in the work folder: the heights before erosion, and three files of every coarser level
GEOMETRY_BYTES = 16.0  # per sample: patches of two levels, coded patches, and their copy in the store
# Per texel of the finest level: tiles, their copy in the store, pieces of one level.
TEXEL_BYTES = {"jpeg": 2.5, "webp": 2.5, "raw": 11.0, "lossless": 4.5}


@dataclass(frozen=True)
class BuildReport:
    """Figures of a terrain that was built.

    Attributes:
        origin: world position of the local zero, meters of the projection, or degrees of longitude and latitude.
        crs: the coordinate reference system in words.
        rows, columns: samples.
        holes: unknown samples of the sources.
        voids: areas that they form, filled or left as holes.
        cell_size: nominal meters between two samples.
        patches, triangles: numbers at all levels.
        tiles: texture tiles.
        bytes: size of the store.
        seconds: times of this run by stage.
        warnings: sentences for the user.
    """

    origin: tuple[float, float]
    crs: str
    rows: int
    columns: int
    holes: int
    voids: VoidCounts
    cell_size: float
    patches: int
    triangles: int
    tiles: int
    bytes: int
    seconds: Mapping[str, float]
    warnings: tuple[str, ...]

    def describe_voids(self) -> str:
        """Return one sentence about voids, empty if there are none."""
        return self.voids.describe(self.cell_size)


def build_terrain(
    field: TerrainField,
    sources: Sequence[Path],
    out: Path,
    settings: BdamSettings,
    images: Sequence[Path] = (),
    executor: Executor | None = None,
) -> Steps[BuildReport]:
    """Build the store of a field in the folder `out`.

    Finished parts are kept in a work folder next to it, from which the same build resumes; it is deleted at the end.

    sources: the files of the field; with their sizes and times they tell whether a work folder belongs to this build. images: files of its
    texture, see `ground_images.place_images`; later ones lie over earlier ones. executor: where
    patches are built; that of the settings if it is None.

    Raises:
        FileError: a source or an image is damaged or does not fit, `out` contains other files, or there is no room.
        SettingsError: a setting is invalid.
        FarfieldError: a worker fails twice.
    """
    check_target(out)
    executor = parse_executor(settings.executor) if executor is None else executor
    recover_store(out)
    clock = StageClock()
    header = _create_header(field, settings, has_texture=bool(images))
    maps = plan_maps(field, header.tree, images, settings)
    folder = work_folder_path(out)
    _check_free_space(out, _estimate_bytes(header, maps, settings.erosion > 0.0), folder)
    leaf_cells = header.leaf_cells
    curvature = header.create_frame().measure_curvature((header.rows, header.columns))
    parameters = BuildParameters(header.rows, header.columns, leaf_cells, header.gradient_step, DIAMONDS_PER_SHARD[leaf_cells], curvature)
    work = WorkFolder(folder, parameters)
    fingerprint = _fingerprint(header, [*sources, *images], maps, settings)
    open_job_folder(folder, fingerprint, "the build of another terrain or with other settings")
    with closing(take_over(folder)) as held:
        remove_temporary_files(folder)
        write_sealed(folder / PARAMETERS_FILE, work.parameters_content)
        with clock.stage("heights"):
            holes, voids = yield from subprogress(_read_sources(field, work, header, settings, maps), 0.0, READ_END)
        start = READ_END
        if settings.erosion > 0.0:
            with clock.stage("erosion"):
                yield from subprogress(_erode(work, header, settings.erosion), READ_END, EROSION_END)
            start = EROSION_END
        with executor.open_task_pool(TASKS_MODULE, [str(folder)], held, "parts") as pool:
            heights_end, fractions = start, _map_fractions(header, maps)
            for textures, fraction in zip(maps, fractions, strict=True):
                end = start + (FINISH_START - heights_end) * fraction
                with clock.stage(textures.name):
                    yield from subprogress(build_texture_tiles(textures, header, work, pool, voids.left > 0), start, end)
                start = end
            with clock.stage("patches"):
                layouts = yield from subprogress(_build_levels(work, pool), start, FINISH_START)
        counts = {TEXTURE_FOLDER: 0}
        with clock.stage("store"), replace_store(out) as target:
            target.mkdir()
            levels = yield from subprogress(write_geometry(work, layouts, header, target), FINISH_START, 1.0)
            for textures in maps:
                counts[textures.name] = yield from subprogress(write_texture_store(textures, work, target), FINISH_START, 1.0)
    delete_work_folder(folder)
    return _create_report(field, header, levels, (holes, voids), counts[TEXTURE_FOLDER], out, clock, maps)


def _read_sources(
    field: TerrainField, work: WorkFolder, header: StoreHeader, settings: BdamSettings, maps: Sequence[TextureWork]
) -> Steps[tuple[int, VoidCounts]]:
    """Write the heights to the work folder, filled as the settings say, and decode images. Return the number of unknown samples and voids.

    A source that cannot be read leaves no work folder behind, since nothing in it is of use.
    """
    grid = replace(work.grid, path=work.path / SOURCE_HEIGHTS_FILE) if settings.erosion > 0.0 else work.grid
    try:
        holes = yield from subprogress(write_heights(field, grid.path, header.height_step), 0.0, 0.6)
        for textures in maps:
            yield from subprogress(decode_images(textures, work), 0.6, 0.8)
    except FarfieldError:
        delete_work_folder(work.path)
        raise
    voids = VoidCounts()
    if holes:
        voids = yield from subprogress(_fill_voids(grid, settings.fill_holes), 0.8, 1.0)
    return holes, voids


def _fill_voids(grid: HeightGrid, which: str) -> Steps[VoidCounts]:
    """Fill voids, unless that was done before. which: see `settings.VOIDS`."""
    path, filled = grid.path.with_name(VOIDS_FILE), grid.path.with_name(FILLED_FILE)
    if not filled.exists():
        temporary = grid.path.with_name(grid.path.name + TEMPORARY_SUFFIX)
        steps = count_voids(grid) if which == "none" else fill_small_voids(grid, temporary)
        counts = yield from subprogress(steps, 0.0, 0.5)
        if not path.exists():  # Nothing is left to count once the file has replaced the grid.
            write_sealed(path, json.dumps(asdict(counts)).encode())
        if which != "none":
            with convert_os_errors(f'"{temporary}" cannot be renamed'):
                temporary.replace(grid.path)
        if which == "all":
            yield from subprogress(fill_holes(grid), 0.5, 1.0)
        write_sealed(filled, b"")
    counts = VoidCounts(**json.loads(read_sealed(path, ADVICE)))
    return counts.all_filled() if which == "all" else counts


def _erode(work: WorkFolder, header: StoreHeader, strength: float) -> Steps[None]:
    """Erode the heights, unless that was done before. The heights before erosion stay until then, so that nothing is eroded twice."""
    source = work.path / SOURCE_HEIGHTS_FILE
    if not work.grid.path.exists():
        yield from erode_heights(replace(work.grid, path=source), work.grid.path, header.cell_size / header.height_step, strength)
    with convert_os_errors(f'"{source}" cannot be deleted'):
        source.unlink(missing_ok=True)


def _estimate_bytes(header: StoreHeader, maps: Sequence[TextureWork], has_erosion: bool) -> int:
    """Return about how many bytes the work folder and the store of a build take together at most."""
    needed = header.rows * header.columns * (HEIGHT_BYTES + GEOMETRY_BYTES + has_erosion * EROSION_BYTES)
    for textures in maps:
        needed += textures.texels * TEXEL_BYTES[textures.plan.image_format] + sum(image.raw_bytes for image in textures.images)
    return int(needed)


def _map_fractions(header: StoreHeader, maps: Sequence[TextureWork]) -> list[float]:
    """Return which part of the time for maps and patches each of the maps takes, roughly."""
    costs = [TEXEL_COST * textures.texels for textures in maps]
    return [cost / (sum(costs) + header.rows * header.columns) for cost in costs]


def _create_report(
    field: TerrainField,
    header: StoreHeader,
    levels: list[Level],
    unknown: tuple[int, VoidCounts],
    tiles: int,
    out: Path,
    clock: StageClock,
    maps: Sequence[TextureWork],
) -> BuildReport:
    with convert_os_errors(f'"{out}" cannot be read'):
        size = folder_bytes(out)
    return BuildReport(
        origin=tuple(header.origin),
        crs=header.crs,
        rows=header.rows,
        columns=header.columns,
        holes=unknown[0],
        voids=unknown[1],
        cell_size=header.cell_size,
        patches=sum(len(level.indices) for level in levels),
        triangles=sum(int(level.counts[:, 1].sum()) for level in levels),
        tiles=tiles,
        bytes=size,
        seconds=dict(clock.seconds),
        warnings=(*field.warnings, *(warning for textures in maps for warning in textures.warnings)),
    )


def _create_header(field: TerrainField, settings: BdamSettings, has_texture: bool) -> StoreHeader:
    rows, columns = field.shape
    height_step = choose_height_step(field, settings.height_step, settings.erosion > 0.0)
    kind = "geographic" if isinstance(field.frame, GeographicFrame) else "projected"
    return StoreHeader(
        rows,
        columns,
        int(settings.patch_size),
        height_step,
        GRADIENT_STEP * field.cell_size / height_step,
        field.cell_size,
        field.crs,
        kind,
        field.frame.first,
        field.frame.step,
        field.frame.origin,
        has_texture,
        has_normal_maps(settings),
    )


def _fingerprint(header: StoreHeader, files: Sequence[Path], maps: Sequence[TextureWork], settings: BdamSettings) -> str:
    with convert_os_errors("A source cannot be read"):
        described = [(str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    planned = [asdict(textures) for textures in maps]
    content = json.dumps([FORMAT_VERSION, asdict(header), described, planned, settings.fill_holes, settings.erosion], sort_keys=True)
    return hashlib.sha256(content.encode("utf-8", "surrogatepass")).hexdigest()


def _build_levels(work: WorkFolder, pool: TaskPool) -> Steps[list[LevelLayout]]:
    """Run the tasks of all levels, from the leaves to the roots. Returns the layouts from level 0."""
    tree = work.tree
    layouts = [LevelLayout.create(tree, level, work.parameters.diamonds_per_shard) for level in range(tree.leaf_level + 1)]
    counts = [layout.count for layout in layouts]
    missing = _find_missing(work, counts)
    done = 0
    for level in range(tree.leaf_level, -1, -1):
        items = [[level, shard] for shard in missing[level]]
        start = (done + counts[level] - len(items)) / sum(counts)
        done += counts[level]
        if items:
            label = f"Level {level} of {tree.leaf_level}"
            yield from subprogress(pool.run(items, label), start, done / sum(counts))
        yield Progress(done / sum(counts), f"Level {level} of {tree.leaf_level}")
        _remove_finer_patches(work, level + 2)
    return layouts


def _find_missing(work: WorkFolder, counts: list[int]) -> list[list[int]]:
    """Return the shards to build at each level: those without intact blocks, and those without intact patches that a coarser level needs.

    Patches of fine levels are deleted early. If blocks of a coarse level are damaged, they must be made again, too.
    """
    missing: list[list[int]] = []
    needs_patches = False
    for level, count in enumerate(counts):
        missing.append([])
        for shard in range(count):
            blocks = work.blocks_path(level, shard)
            is_intact = validate_or_remove(blocks)
            if needs_patches and level < work.tree.leaf_level and not validate_or_remove(work.patches_path(level, shard)):
                is_intact = False
                with convert_os_errors(f'"{blocks}" cannot be deleted'):
                    blocks.unlink(missing_ok=True)
            if not is_intact:
                missing[-1].append(shard)
        needs_patches = bool(missing[-1])
    return missing


def _remove_finer_patches(work: WorkFolder, level: int) -> None:
    """Delete the patches of a level that no coarser level needs any more; their blocks stay."""
    for path in work.path.glob(f"patches-{level:02d}-*.shard"):
        with convert_os_errors(f'"{path}" cannot be deleted'):
            path.unlink(missing_ok=True)


def _check_free_space(out: Path, needed: int, work_folder: Path) -> None:
    """Check that `needed` bytes, less what the work folder has already, fit on the disk of the folder `out`.

    Raises:
        FileError: they do not.
    """
    with convert_os_errors(f'The free space of "{out.parent}" cannot be found out'):
        place = next(parent for parent in out.absolute().parents if parent.exists())
        free = shutil.disk_usage(place).free
        kept = folder_bytes(work_folder) if work_folder.is_dir() else 0
    if needed - kept > free:
        raise FileError(
            f'The disk of "{place}" has {format_bytes(free)} left, and the build needs about {format_bytes(needed - kept)} there; '
            "free some space, or choose another disk."
        )
