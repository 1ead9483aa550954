"""Hues are those of the surface, whatever the light, and taking them out leaves nothing but light."""

from dataclasses import dataclass

import numpy as np
import pytest

from farfield.addon.core.btf.factors import factorise
from farfield.addon.core.btf.quality import quality
from farfield.addon.core.btf.tints import tints
from farfield.addon.core.progress import finish

ALBEDOS = np.random.default_rng(0).uniform(0.1, 0.9, (50, 3)).astype(np.float32)


@dataclass(frozen=True)
class Lit:
    """Texels of many albedos under four lights: one component is enough once the hues are out."""

    view: int
    over: np.ndarray | None = None

    def read(self):
        random = np.random.default_rng(self.view)
        index = np.flatnonzero(random.random(50) < 0.8)
        values = ALBEDOS[index, None] * random.uniform(0.2, 1.0, 4)[:, None].astype(np.float32)
        if self.over is not None:
            values = values / self.over[index, None]
        return index, values.reshape(len(index), -1).astype(np.float32)


def test_tints_are_the_albedos_up_to_their_brightness():
    found = finish(tints([Lit(view) for view in range(6)], 51, np.ones(6), np.ones(4)))
    np.testing.assert_allclose(found[:50], ALBEDOS / ALBEDOS.mean(axis=1, keepdims=True), rtol=1e-5)
    assert (found[50] == 1.0).all()


def test_without_hues_one_component_tells_all():
    views, columns = np.ones(6), np.ones(12)
    hues = finish(tints([Lit(view) for view in range(6)], 50, views, np.ones(4)))
    bare = [Lit(view, hues) for view in range(6)]
    colour = finish(factorise(bare, 50, 2, views, columns))
    fits = finish(quality([Lit(view) for view in range(6)], colour, hues, views, columns))
    assert [fit.components for fit in fits] == [0, 1, 2]
    assert fits[1].rms == pytest.approx(0.0, abs=0.01) and fits[0].rms > 0.1
    assert fits[2].psnr >= fits[1].psnr > 35.0
