"""Builds of large terrain with Dask."""

import numpy as np
import pytest

from farfield.addon.core.bdam.building.terrain_build import build_terrain
from farfield.addon.core.bdam.fields.terrain_field import FieldSettings, open_field
from farfield.addon.core.bdam.settings import BdamSettings
from farfield.addon.core.jobs.progress import run_to_end
from lib.executors import open_executor
from small_terrain_stores import colors, hills
from tiff_writer import write_tiff

pytest.importorskip("zstandard")
ROWS, COLUMNS = 65, 81


@pytest.mark.once
@pytest.mark.exhaustive  # Other tests run tasks with Dask, and builds in processes.
def test_dask_builds_the_same_bytes_with_textures(scheduler, tmp_path):
    scheduler.start_workers(2)
    heights = hills(ROWS, COLUMNS)
    heights[20:30, 40:50] = np.nan
    source = tmp_path / "heights.npy"
    np.save(source, heights.astype(np.float32))
    image = write_tiff(tmp_path / "ground.tif", colors(700), tile=(64, 64))
    folders = []
    for word in ("serial", f"dask:{scheduler.address}"):
        folders.append(tmp_path / f"store {len(folders)}")
        field = open_field([source], FieldSettings(cell_size=10.0))
        with open_executor(word) as executor:
            run_to_end(build_terrain(field, [source], folders[-1], BdamSettings(patch_size="16"), [image], executor))
    serial, dask = ({path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*")} for folder in folders)
    assert len(serial) == 12 and dask == serial
    assert sorted(path.name for path in tmp_path.glob("store*")) == ["store 0", "store 1"], "nothing is left over"
