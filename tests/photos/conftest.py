"""Fixtures of the tests of photo textures."""

import pytest

from farfield.addon.core.photos import merging
from farfield.addon.core.photos.registration import refinement
from farfield.addon.core.photos.texels import pages

OBSERVED_POINTS, EXPOSURE_POINTS = 6_000, 4_000
OVERLAP_SIZE = 256


@pytest.fixture(scope="module")
def quick_merges():
    """Merges compare photographs at fewer points than usual, and look for overlaps of UV maps at fewer texels: as good for the small
    photographs and textures of tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(merging, "POINTS", OBSERVED_POINTS)
        patch.setattr(refinement, "EXPOSURE_POINTS", EXPOSURE_POINTS)
        patch.setattr(pages, "OVERLAP_SIZE", OVERLAP_SIZE)
        yield
