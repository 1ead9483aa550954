"""Copies of a voxel model on hills: position, rotation and scale follow from their cell, and they stand on the ground."""

from pathlib import Path

import numpy as np
import pytest

from farfield.addon.core.clipbox.files.readers import READERS
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.forest import MEAN_CUBED_SCALE, MIN_SCALE, Forest
from farfield.addon.core.clipbox.terrains.generators import build_sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.clipbox.terrains.volume_terrain import read_voxel_model
from farfield.addon.core.errors import FileError, SettingsError


def hook() -> np.ndarray:
    """A post with a long arm along x and a short one along y, which differs from all of its rotations and mirror images."""
    solid = np.zeros((16, 16, 24), bool)
    solid[6:10, 6:10] = True
    solid[10:16, 6:10, 20:] = True
    solid[6:10, 10:13, 8:12] = True
    return solid


def hook_forest(folder: Path, hills: float = 0.0, spacing: float = 48.0, seed: int = 3) -> Forest:
    """Hooks, the largest 24 scene units high, with one scene unit per voxel."""
    np.save(folder / "hook.npy", hook())
    settings = ClipboxSettings(terrain="forest", source=str(folder / "hook.npy"), plant_size=24.0)
    return Forest(read_voxel_model(settings, READERS), spacing, hills, seed)


def test_copies_have_the_position_rotation_and_scale_of_their_cell(tmp_path):
    forest = hook_forest(tmp_path)
    grid = Grid((-96, -96, 0), (192, 192, 30), 1.0)
    copies = forest.find_copies(grid)
    solid = forest.densities(grid) > 0
    orientations = set()
    for position, scale, transposed, signs in zip(copies.positions, copies.scales, copies.transposed, copies.signs, strict=True):
        assert MIN_SCALE <= scale <= 1.0 and position[2] == 0.0
        if np.abs(position[:2]).max() > 80.0:
            continue
        orientations.add((bool(transposed), *signs.tolist()))
        for x, y, z, expected in ((0.0, 0.0, 12.0, True), (5.0, 0.0, 22.0, True), (-5.0, 0.0, 22.0, False), (0.0, 3.5, 10.0, True)):
            local = np.array([x, y]) * signs
            oriented = local[::-1] if transposed else local
            voxel = np.floor(position + scale * np.array([*oriented, z])).astype(int) - grid.origin
            assert solid[tuple(voxel)] == expected, (position, scale, transposed, signs, x, y, z)
    assert len(orientations) >= 4


def test_copies_have_their_volume_and_nothing_is_between_them(tmp_path):
    forest = hook_forest(tmp_path)
    grid = Grid((-240, -240, 0), (480, 480, 26), 1.0)  # ten cells along each axis
    solid_count = int((forest.densities(grid) > 0).sum())
    assert solid_count == pytest.approx(100 * hook().sum() * MEAN_CUBED_SCALE, rel=0.15)
    assert not (hook_forest(tmp_path, spacing=2000.0).densities(Grid((20, 20, 1), (300, 300, 25), 1.0)) > 0).any()


def test_copies_stand_on_the_hills(tmp_path):
    forest = hook_forest(tmp_path, hills=20.0)
    grid = Grid((-96, -96, -30), (192, 192, 90), 1.0)
    densities = forest.densities(grid)
    x, y, _ = grid.coordinates()
    ground = forest.ground_heights(x[:, :, 0], y[:, :, 0])
    assert np.ptp(ground) > 6.0 and np.abs(ground).max() <= 20.0 * (0.5 + 0.25 + 0.125)
    tops = grid.origin[2] + 90 - (densities > 0)[:, :, ::-1].argmax(axis=2)
    assert (tops >= ground - 1.0).all() and (tops <= ground + 24.0 + 8.0).all()
    copies = forest.find_copies(grid)
    for position, scale in zip(copies.positions, copies.scales, strict=True):
        if np.abs(position[:2]).max() < 90.0:
            i, j = np.floor(position[:2]).astype(int) + 96
            assert tops[i, j] == pytest.approx(position[2] + 24.0 * scale, abs=1.6)


def test_voxels_too_large_for_copies_raise_the_ground(tmp_path):
    forest = hook_forest(tmp_path, spacing=24.0)
    coarse = forest.densities(Grid((-4, -4, -4), (8, 8, 8), 16.0))
    _, _, z = Grid((-4, -4, -4), (8, 8, 8), 16.0).coordinates()
    canopy_volume = hook().any(axis=2).sum() * 24.0 - 12 * (24.0 - 12.0)  # the lower arm ends at half the height
    assert np.allclose(coarse + z, MEAN_CUBED_SCALE * canopy_volume / 24.0**2, atol=1e-3)


def test_thin_parts_survive_averaging(tmp_path):
    """A lattice of rods fills an eighth of its model: means are below the threshold everywhere."""
    rods = np.zeros((32, 32, 32), np.uint8)
    for axis in range(3):
        np.moveaxis(rods, axis, 0)[:, 3::8, 3::8] = 200
    np.save(tmp_path / "rods.npy", rods)
    settings = ClipboxSettings(terrain="volume", source=str(tmp_path / "rods.npy"), source_size=32.0)
    function = build_sampler(settings).function
    fine = function(Grid((-20, -20, -4), (40, 40, 40), 1.0)) > 0
    coarse = function(Grid((-5, -5, -1), (10, 10, 10), 4.0)) > 0
    for axis in range(3):
        assert 16 * coarse.any(axis=axis).sum() == pytest.approx(fine.any(axis=axis).sum(), rel=0.5)


def test_the_seed_determines_the_forest(tmp_path):
    grid = Grid((-40, -40, -2), (80, 80, 20), 1.5)
    first, again, other = (hook_forest(tmp_path, hills=5.0, seed=seed).densities(grid) for seed in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_a_forest_needs_a_file_with_voxels(tmp_path):
    with pytest.raises(SettingsError, match='The terrain "forest" needs a file'):
        build_sampler(ClipboxSettings(terrain="forest"))
    np.save(tmp_path / "map.npy", np.ones((4, 4)))
    with pytest.raises(FileError, match="contains heights, not voxels"):
        build_sampler(ClipboxSettings(terrain="forest", source=str(tmp_path / "map.npy")))
