"""Properties of affine transforms."""

import numpy as np

from farfield.addon.core.geometry.transforms import is_mirroring


def test_mirroring_and_matrices_that_are_not_finite():
    mirrored = np.diag([1.0, -2.0, 1.0, 1.0])
    assert is_mirroring(np.stack([np.eye(4), mirrored, np.full((4, 4), np.nan)])).tolist() == [False, True, False]
    assert is_mirroring(mirrored[:3, :3]) and not is_mirroring(-mirrored[:3, :3])
