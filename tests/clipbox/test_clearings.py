"""Where a viewer of a new terrain stands: in the air, with space in all directions."""

import numpy as np
import pytest

from farfield.addon.core.clipbox.engine import TerrainEngine
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.generators import build_sampler
from farfield.addon.core.clipbox.terrains.grids import Grid


def clearing(position, **values):
    return TerrainEngine(ClipboxSettings(**values)).find_clearing(np.array(position, np.float64))


def test_in_the_air_a_viewer_stays():
    assert clearing((3.0, 4.0, 50.0), terrain="formula", formula="-z").tolist() == [3.0, 4.0, 50.0]


@pytest.mark.parametrize("voxel_size", [0.5, 1.0, 4.0])
def test_below_the_ground_a_viewer_rises_to_the_lowest_clear_height(voxel_size):
    x, y, z = clearing((3.0, 4.0, -70.0), terrain="formula", formula="-z", voxel_size=voxel_size)
    assert (x, y) == (3.0, 4.0) and 12.0 * voxel_size <= z <= 20.0 * voxel_size


def test_without_air_a_viewer_stays():
    assert clearing((0.0, 0.0, 0.0), terrain="formula", formula="1.0").tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("terrain", ["cascades", "islands", "spheres"])
def test_a_viewer_has_air_in_all_directions(terrain):
    settings = ClipboxSettings(terrain=terrain)
    engine, sampler = TerrainEngine(settings), build_sampler(settings)
    for start in np.random.default_rng(4).uniform(-150.0, 150.0, (4, 3)):
        position = engine.find_clearing(start)
        assert position[2] >= start[2]
        origin = np.floor(position).astype(int) - 6
        assert not (sampler.densities(Grid(tuple(origin.tolist()), (12, 12, 12), 1.0)) > 0.0).any()
