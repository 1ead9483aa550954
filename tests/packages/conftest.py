"""Fixtures of the tests of packages."""

import pytest

from farfield.addon.core.packages.textures import avif_files, visibility


@pytest.fixture(scope="module")
def fast_coding():
    """Images are coded in a fraction of the usual time, to slightly larger files."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(avif_files, "SPEED", 10)
        yield


@pytest.fixture(scope="module")
def small_images():
    """Which texels are visible is measured in smaller images than usual: as good for the small textures of tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(visibility, "MIN_SAMPLES", 128)
        yield
