"""Chromaticity is that of the albedo under any light, and dividing by it removes all variation between texels."""

from dataclasses import dataclass

import numpy as np
import pytest

from farfield.addon.core.btf.factorization.als import ViewMatrix
from farfield.addon.core.btf.factorization.factors import error_by_components, factorize
from farfield.addon.core.btf.reflectance.mean_colors import compute_chromaticity
from farfield.addon.core.jobs.progress import run_to_end

ALBEDOS = np.random.default_rng(0).uniform(0.1, 0.9, (50, 3)).astype(np.float32)


@dataclass(frozen=True)
class AlbedoView:
    """Texels of different albedos under four lights, optionally divided by `divisor` (N, 3)."""

    view: int
    divisor: np.ndarray | None = None

    def read(self):
        random = np.random.default_rng(self.view)
        rows = np.flatnonzero(random.random(50) < 0.8)
        values = ALBEDOS[rows, None] * random.uniform(0.2, 1.0, 4)[:, None].astype(np.float32)
        if self.divisor is not None:
            values = values / self.divisor[rows, None]
        return rows, values.reshape(len(rows), -1).astype(np.float32)


def albedo_views(divisor: np.ndarray | None = None) -> list[AlbedoView]:
    return [AlbedoView(view, divisor) for view in range(6)]


def test_chromaticity_is_the_albedo_over_its_mean():
    chromaticity = run_to_end(compute_chromaticity(albedo_views(), 51, np.ones(6), np.ones(4)))
    np.testing.assert_allclose(chromaticity[:50], ALBEDOS / ALBEDOS.mean(axis=1, keepdims=True), rtol=1e-5)
    assert (chromaticity[50] == 1.0).all()


def test_colors_over_chromaticity_need_one_component():
    weights, column_weights = np.ones(6), np.ones(12)
    chromaticity = run_to_end(compute_chromaticity(albedo_views(), 50, weights, np.ones(4)))
    color = run_to_end(factorize(ViewMatrix(albedo_views(chromaticity), 50, weights, column_weights), 2))
    errors = run_to_end(error_by_components(ViewMatrix(albedo_views(), 50, weights, column_weights), color, chromaticity))
    assert [error.components for error in errors] == [0, 1, 2]
    assert errors[1].rms == pytest.approx(0.0, abs=0.01) and errors[0].rms > 0.1
    assert errors[2].psnr >= errors[1].psnr > 35.0
