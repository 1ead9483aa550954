"""Factors of small symmetric matrices solve them, and leave out what is singular."""

import numpy as np
import pytest

from farfield.addon.core.texmesh.refitting.least_squares import factorize_blocks


@pytest.mark.parametrize("size", [1, 3, 5])
def test_factors_solve_all_blocks(size):
    generator = np.random.default_rng(size)
    roots = generator.normal(size=(40, size, size))
    blocks = roots @ roots.swapaxes(1, 2) + 0.1 * np.eye(size)
    values = generator.normal(size=(40, size))
    found = factorize_blocks(np.tril(blocks).transpose(1, 2, 0)).solve(values.T).T
    np.testing.assert_allclose(found, np.linalg.solve(blocks, values[..., None])[..., 0], rtol=1e-9)


def test_blocks_of_zeros_have_zero_solutions_and_dependent_rows_finite_ones():
    vectors = np.random.default_rng(1).normal(size=(20, 5))
    blocks = vectors[:, :, None] * vectors[:, None, :]
    blocks[0] = 0.0
    found = factorize_blocks(blocks.transpose(1, 2, 0)).solve(np.ones((5, 20)))
    assert not found[:, 0].any() and np.isfinite(found).all() and np.abs(found).max() < 1e6
