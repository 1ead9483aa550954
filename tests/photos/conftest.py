"""Fixtures of the tests of photo textures."""

import pytest

from farfield.addon.core.photos import merging

OBSERVED_POINTS = 12_000


@pytest.fixture(scope="module")
def few_observations():
    """Merges compare photographs at fewer points than usual: four times as fast, and as good for the small photographs of tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(merging, "POINTS", OBSERVED_POINTS)
        yield
