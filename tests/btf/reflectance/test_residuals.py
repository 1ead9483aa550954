"""Residuals are captured colors without lobes over chromaticity, clamped under lobes, and temporary."""

import numpy as np
import pytest

from farfield.addon.core.btf.capture.observations import Observation, ReferenceImage
from farfield.addon.core.btf.capture.shards import ShardStore
from farfield.addon.core.btf.capture.view_data import RadianceView
from farfield.addon.core.btf.reflectance.disc_lights import DiscLights
from farfield.addon.core.btf.reflectance.residuals import MAX_DOME_RESIDUAL, MAX_RESIDUAL, residual_files, write_residuals
from farfield.addon.core.geometry.directions import DirectionGrid
from farfield.addon.core.jobs.progress import run_to_end
from random_textures import random_lobes

VIEWS, LIGHTS = DirectionGrid(2), DirectionGrid(3)
SUNS = DiscLights(LIGHTS.directions, float(LIGHTS.solid_angles.mean()))
COUNT = 40
CHROMATICITY = np.random.default_rng(1).uniform(0.5, 1.5, (COUNT, 3)).astype(np.float32)


def write_store(folder, lobes, offset: float) -> ShardStore:
    """Write views of every second texel with the radiance of `lobes` plus `offset`."""
    store = ShardStore(folder)
    store.open("bake")
    visible = np.arange(0, COUNT, 2, dtype=np.int32)
    reference = ReferenceImage(np.zeros((5, 2, 2, 3), np.float32), np.zeros((2, 2), np.float32))
    counts = np.full(len(visible), 9, np.uint8)
    for view, direction in enumerate(VIEWS.directions):
        radiance = lobes.radiance_on_grid(direction, SUNS, visible).swapaxes(0, 1) + offset
        observation = Observation(np.ones(COUNT, bool), np.ones(COUNT, np.float32), visible, counts, radiance.astype(np.float32))
        store.write(view, observation, reference, [], 1.0)
    return store


def test_residuals_are_the_difference_to_the_lobes_over_chromaticity(tmp_path):
    lobes = random_lobes(COUNT)
    store = write_store(tmp_path, lobes, 0.1)
    for view in run_to_end(write_residuals(store, CHROMATICITY, lobes, VIEWS, SUNS)):
        rows, values = view.read()
        np.testing.assert_array_equal(rows, np.arange(0, COUNT, 2))
        np.testing.assert_allclose(values.reshape(20, -1, 3) * CHROMATICITY[rows, None], 0.1, atol=0.01)
    residual_files(store).remove_all()
    assert not list(tmp_path.glob("residuals-*")) and store.is_valid(3)


def test_residuals_are_clamped_under_lobes(tmp_path):
    lobes = random_lobes(COUNT)
    view = run_to_end(write_residuals(write_store(tmp_path, lobes, 7.0), CHROMATICITY, lobes, VIEWS, SUNS))[1]
    rows, values = view.read()
    residuals = values.reshape(20, -1, 3) * CHROMATICITY[rows, None]
    np.testing.assert_allclose(residuals[:, :-1], MAX_RESIDUAL, rtol=0.01)
    np.testing.assert_allclose(residuals[:, -1], MAX_DOME_RESIDUAL, rtol=0.01)


@pytest.mark.parametrize("offset", [0.0, 7.0])
def test_without_lobes_residuals_are_not_clamped(tmp_path, offset):
    store = write_store(tmp_path, random_lobes(COUNT), offset)
    view = run_to_end(write_residuals(store, np.ones_like(CHROMATICITY), None, VIEWS, SUNS))[2]
    np.testing.assert_allclose(view.read()[1], RadianceView(store, 2).read()[1], rtol=1e-3)
