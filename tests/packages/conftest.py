"""Fixtures of the tests of packages."""

import pytest

from farfield.addon.core.packages.textures import visibility


@pytest.fixture(scope="module")
def small_images():
    """Which texels are visible is measured in smaller images than usual: as good for the small textures of tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(visibility, "MIN_SAMPLES", 128)
        yield
