"""The build of a terrain: heights, then patches level by level from the finest to the coarsest, then the store (BDAM, section 5)."""

import hashlib
import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from ...errors import FileError
from ...files.atomic_write import atomic_write
from ...files.file_access import convert_os_errors
from ...files.sealed_files import validate_or_remove, write_sealed
from ...jobs import heartbeat
from ...jobs.job_folder import open_job_folder, remove_temporary_files
from ...jobs.progress import Progress, Steps, subprogress
from ...jobs.task_pool import open_task_pool
from ..fields.placements import GeographicFrame
from ..fields.terrain_field import TerrainField
from ..settings import BdamSettings
from ..store.structure import STRUCTURE_FILE, StoreHeader
from .finish import write_geometry
from .heights import choose_height_step, write_heights
from .work_folder import HEIGHTS_FILE, PARAMETERS_FILE, BuildParameters, LevelLayout, WorkFolder

TASKS_MODULE = "addon.core.bdam.build.tasks"
FORMAT_VERSION = 1  # of the files in a work folder
WORK_SUFFIX = ".build"
DIAMONDS_PER_SHARD = {16: 256, 32: 64, 64: 16}  # by cells of a leaf: about as many samples
SLOPE_STEP = 1.0 / 64.0  # meters of height per meter
READ_END, FINISH_START = 0.05, 0.95  # of the progress


def build_terrain(field: TerrainField, sources: Sequence[Path], out: Path, settings: BdamSettings) -> Steps[None]:
    """Build the store of a field in the folder `out`.

    Finished parts are kept in a folder beside it, from which the same build resumes; it is deleted at the end.

    sources: the files of the field; with their sizes and times they tell whether a work folder belongs to this build.

    Raises:
        FileError: a source is damaged, `out` contains other files, or a file cannot be written.
        SettingsError: a setting is invalid.
        FarfieldError: a worker fails twice.
    """
    check_target(out)
    header = _create_header(field, settings)
    folder = out.with_name(out.name + WORK_SUFFIX)
    leaf_cells = header.leaf_cells
    parameters = BuildParameters(header.rows, header.columns, leaf_cells, header.slope_step, DIAMONDS_PER_SHARD[leaf_cells])
    work = WorkFolder(folder, parameters)
    open_job_folder(folder, _fingerprint(header, sources), "the build of another terrain or with other settings")
    with _hold(folder) as held:
        remove_temporary_files(folder)
        write_sealed(folder / PARAMETERS_FILE, work.parameters_content)
        yield from subprogress(write_heights(field, folder / HEIGHTS_FILE, header.height_step), 0.0, READ_END)
        layouts = yield from subprogress(_build_levels(work, settings.executor, held), READ_END, FINISH_START)
        with _replace_store(out) as target:
            target.mkdir()
            yield from subprogress(write_geometry(work, layouts, header, target), FINISH_START, 1.0)
    with convert_os_errors(f'The terrain is finished, but its work folder "{folder}" cannot be deleted'):
        shutil.rmtree(folder)


def check_target(out: Path) -> None:
    """Raise FileError unless the folder `out` is missing, empty, or a terrain, which a build replaces."""
    with convert_os_errors(f'"{out}" cannot be used'):
        if out.exists() and not out.is_dir():
            raise FileError(f'"{out}" is a file; choose a folder for the terrain.')
        if out.is_dir() and not (out / STRUCTURE_FILE).exists() and any(out.iterdir()):
            raise FileError(f'"{out}" contains other files; choose an empty or a new folder for the terrain.')


def _create_header(field: TerrainField, settings: BdamSettings) -> StoreHeader:
    rows, columns = field.shape
    height_step = choose_height_step(field, settings.height_step)
    kind = "geographic" if isinstance(field.frame, GeographicFrame) else "projected"
    return StoreHeader(
        rows,
        columns,
        int(settings.leaf),
        height_step,
        SLOPE_STEP * field.cell_size / height_step,
        field.cell_size,
        field.crs,
        kind,
        field.frame.first,
        field.frame.step,
        field.frame.origin,
    )


def _fingerprint(header: StoreHeader, sources: Sequence[Path]) -> str:
    with convert_os_errors("A source cannot be read"):
        files = [(str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns) for path in sources]
    content = json.dumps([FORMAT_VERSION, asdict(header), files], sort_keys=True)
    return hashlib.sha256(content.encode("utf-8", "surrogatepass")).hexdigest()


def _build_levels(work: WorkFolder, executor: str, held: heartbeat.Heartbeat) -> Steps[list[LevelLayout]]:
    """Run the tasks of all levels, from the leaves to the roots. Returns the layouts from level 0."""
    tree = work.tree
    layouts = [LevelLayout.create(tree, level, work.parameters.diamonds_per_shard) for level in range(tree.leaf_level + 1)]
    counts = [layout.count for layout in layouts]
    with open_task_pool(executor, TASKS_MODULE, [str(work.path)], held, "patches") as pool:
        done = 0
        for level in range(tree.leaf_level, -1, -1):
            items = [[level, shard] for shard in range(counts[level]) if not _is_finished(work, level, shard)]
            start = (done + counts[level] - len(items)) / sum(counts)
            done += counts[level]
            if items:
                label = f"Level {level} of {tree.leaf_level}"
                yield from subprogress(pool.run(items, label), start, done / sum(counts))
            yield Progress(done / sum(counts), f"Level {level} of {tree.leaf_level}")
            _remove_finer_patches(work, level + 2)
    return layouts


def _is_finished(work: WorkFolder, level: int, shard: int) -> bool:
    return validate_or_remove(work.blocks_path(level, shard))


def _remove_finer_patches(work: WorkFolder, level: int) -> None:
    """Delete the patches of a level that no coarser level needs any more; their blocks stay."""
    for path in work.path.glob(f"patches-{level:02d}-*.shard"):
        with convert_os_errors(f'"{path}" cannot be deleted'):
            path.unlink(missing_ok=True)


@contextmanager
def _hold(folder: Path) -> Iterator[heartbeat.Heartbeat]:
    """Own a work folder until the end of the block."""
    held = heartbeat.take_over(folder)
    try:
        yield held
    finally:
        held.close()


@contextmanager
def _replace_store(out: Path) -> Iterator[Path]:
    """Yield a temporary folder that becomes `out` at the end. A terrain that was there before is deleted then."""
    with atomic_write(out.with_name(f"{out.name}.new")) as temporary:
        yield temporary
    new = out.with_name(f"{out.name}.new")
    with convert_os_errors(f'The terrain is finished in "{new}", but "{out}" cannot be replaced'):
        if out.exists():
            shutil.rmtree(out)
        new.rename(out)
