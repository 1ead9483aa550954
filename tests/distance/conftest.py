"""Fixtures of the tests of scenes that are made distance-ready."""

from functools import partial

import pytest


@pytest.fixture
def quick_levels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make levels and clouds in a fraction of a second; which ones is not tested here."""
    from farfield.addon.core.billboards.settings import BillboardSettings
    from farfield.addon.core.distance import levels
    from farfield.addon.core.texmesh import TexmeshSettings
    from farfield.addon.operators.distance import build

    level_settings = {"levels": "ratios", "ratios": "0.5,0.2", "views": 1, "max_image": 32, "vertices": "original"}
    monkeypatch.setattr(build, "TexmeshSettings", partial(TexmeshSettings, **level_settings))
    monkeypatch.setattr(build, "BillboardSettings", partial(BillboardSettings, samples=1, error=0.05))
    for name in ("FEW_TRIANGLES", "MANY_TRIANGLES"):  # Otherwise such small scenes would have neither.
        monkeypatch.setattr(levels, name, 0)
