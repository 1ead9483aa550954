"""Refined silhouettes make whole pictures right: no gaps, no double cover, and the slope is that of the error."""

from dataclasses import dataclass

import numpy as np
import pytest

from farfield.addon.core.btf import training
from farfield.addon.core.btf.factors import Factors
from farfield.addon.core.btf.fragments import Fragments, fragments_of
from farfield.addon.core.btf.photographs import Photograph, broad_lights, photograph_of
from farfield.addon.core.btf.refine import RAYS, Look, _Compositing, refined, seen, shown, texel_colours
from farfield.addon.core.btf.shards import ShardStore
from farfield.addon.core.btf.texels import Picture, Quads, Texels, View, texels_of
from farfield.addon.core.direction_grids import DirectionGrid
from farfield.addon.core.progress import finish

SIZE, DEEP = (22, 10), 16
GREY = 0.4


def sheets() -> Quads:
    """Two sheets of 8 x 8 texels, one right above the other."""
    flat = np.array([[0, 0], [8, 0], [8, 8], [0, 8]], float)
    return Quads([np.column_stack([flat, np.full(4, height)]) for height in (0.0, 0.2)], [flat + [1.0, 1.0], flat + [12.0, 1.0]])


def stack() -> Quads:
    """DEEP sheets one above the other."""
    flat = np.array([[0, 0], [8, 0], [8, 8], [0, 8]], float)
    heights = np.linspace(0.0, 0.4, DEEP)
    return Quads([np.column_stack([flat, np.full(4, height)]) for height in heights], [flat + [11.0 * i + 1.0, 1.0] for i in range(DEEP)])


@dataclass
class Shot:
    """One view of `quads` with its photograph; all that it meets is GREY."""

    view: View
    taken: Photograph
    quads: Quads

    @property
    def texels(self) -> Texels:
        return texels_of(self.quads, (11 * len(self.quads.corners), SIZE[1]))

    def fragments(self) -> Fragments:
        return fragments_of(self.quads, self.texels, self.view, RAYS)

    def look(self) -> Look:
        found = self.fragments()
        return Look(found, shown(found, np.full((len(self.texels), 15), GREY)), self.taken)


def shots(coverage: float, quads: Quads | None = None) -> list[Shot]:
    """Views from above, straight and aslant, of a grey sheet that lets 1 - `coverage` through."""
    views = [
        View(np.array(each) / np.linalg.norm(each), np.array([4.0, 4.0, 0.0]), 8, 1.0) for each in ([0, 0, 1], [0.1, 0, 1], [0, 0.1, 1])
    ]
    alpha = np.full((8, 8), coverage, np.float32)
    return [
        Shot(view, Photograph(np.broadcast_to(GREY * alpha[None, ..., None], (5, 8, 8, 3)).copy(), alpha), quads or sheets())
        for view in views
    ]


def no_factors(texels: int, views: int) -> Factors:
    """An alpha that adds nothing."""
    return Factors(np.zeros((texels, 1), np.float32), np.ones((views, 1, 1), np.float32), np.ones(texels, bool))


def composed(shot: Shot, alpha: np.ndarray) -> np.ndarray:
    found = shot.fragments()
    own = np.clip((alpha[found.texels] * found.shares).sum(axis=1), 0.0, 1.0)
    return np.bincount(found.ray // RAYS**2, found.transmitted(own) * own, minlength=64).reshape(8, 8) / RAYS**2


@pytest.mark.parametrize(("own", "wanted"), [(0.5, 1.0), (0.5, 0.5)], ids=["gap", "double cover"])
def test_two_quads_add_up_to_what_is_seen(own, wanted):
    """Each texel is half covered: together that is three quarters, whatever the picture says."""
    taken, texels = shots(wanted), texels_of(sheets(), SIZE)
    plain = np.full(len(texels), own, np.float32)
    better = finish(refined(taken, no_factors(len(texels), len(taken)), plain, np.ones(len(taken))))
    for number, shot in enumerate(taken):
        before = np.abs(composed(shot, plain) - wanted)[1:-1, 1:-1]
        after = np.abs(composed(shot, plain + better.weights @ better.basis[number, :, 0]) - wanted)[1:-1, 1:-1]
        assert before.mean() == pytest.approx(0.25, abs=0.01)
        assert after.mean() < 0.3 * before.mean()


@pytest.mark.parametrize("wanted", [0.3, 0.9])
def test_a_deep_stack_does_not_swing(wanted):
    """So many texels lie along a ray that each of them moves little, and all of them move the picture much."""
    taken = shots(wanted, stack())
    count = len(taken[0].texels)
    plain = np.full(count, 0.15, np.float32)
    better = finish(refined(taken, no_factors(count, len(taken)), plain, np.ones(len(taken))))
    for number, shot in enumerate(taken):
        after = composed(shot, plain + better.weights @ better.basis[number, :, 0])[1:-1, 1:-1]
        assert np.abs(after - wanted).mean() < 0.03


def test_what_is_right_stays():
    taken, texels = shots(0.75), texels_of(sheets(), SIZE)
    better = finish(refined(taken[:1], no_factors(len(texels), 1), np.full(len(texels), 0.5, np.float32), np.ones(1)))
    assert np.abs(better.weights @ better.basis[0, :, 0]).max() < 0.02


def test_the_slope_is_that_of_the_error():
    random = np.random.default_rng(0)
    shot, texels = shots(0.6)[1], texels_of(sheets(), SIZE)
    look = _Compositing(Look(shot.fragments(), random.random((len(shot.fragments()), 15)), shot.taken), len(texels))
    alpha = random.uniform(0.2, 0.8, len(texels))
    slope, bend = look.against(alpha)
    for texel in random.permutation(np.flatnonzero(bend))[:12]:
        step = np.zeros(len(texels))
        step[texel] = 1e-3
        numeric = (look.error(alpha + step) - look.error(alpha - step)) / 2e-3
        assert slope[texel] == pytest.approx(numeric, rel=0.02, abs=0.02 * float(np.abs(slope).max()))


def test_broad_lights_are_sums_of_the_renders():
    grid = DirectionGrid(4)
    radiance = np.random.default_rng(1).random((len(grid) + 1, 2, 2, 3)).astype(np.float32)
    taken = photograph_of(Picture(radiance, np.ones((2, 2), np.float32), np.zeros((6, 6), np.int32), np.zeros((6, 6))), broad_lights(grid))
    np.testing.assert_allclose(taken.colours[0], np.tensordot(grid.solid_angles, radiance[:-1], 1), rtol=1e-5)
    np.testing.assert_allclose(taken.colours[3], np.tensordot(grid.solid_angles * grid.directions[:, 2], radiance[:-1], 1), atol=1e-5)
    np.testing.assert_allclose(taken.colours[4], radiance[-1])


def test_what_lies_behind_opaque_texels_is_not_seen():
    texels, above = texels_of(sheets(), SIZE), View(np.array([0.0, 0.0, 1.0]), np.array([4.0, 4.0, 0.0]), 8, 1.0)
    fragments = fragments_of(sheets(), texels, above, RAYS)
    opaque = seen(fragments, np.ones(len(texels), np.float32))
    assert set(texels.quads[opaque.texels].ravel()) == {1} and opaque.rays == fragments.rays
    np.testing.assert_array_equal(np.diff(opaque.ray) > 0, True)
    clear = seen(fragments, np.full(len(texels), 0.5, np.float32))
    np.testing.assert_array_equal(clear.texels, fragments.texels)


def test_texels_show_their_factors_under_sums_of_lights():
    random = np.random.default_rng(4)
    colour = Factors(random.random((6, 2)).astype(np.float32), random.normal(size=(3, 2, 12)).astype(np.float32), np.ones(6, bool))
    hues, lights = random.random((6, 3)).astype(np.float32), random.random((4, 5))
    of_lights = (colour.weights @ colour.basis[1]).reshape(6, 4, 3) * hues[:, None]
    found = texel_colours(colour, 1, hues, lights)
    np.testing.assert_allclose(found, np.einsum("nlc,lm->nmc", of_lights, lights).reshape(6, 15), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("room", [1e9, 0.0], ids=["memory", "folder"])
def test_looks_come_back_from_memory_and_from_the_folder(room, tmp_path, monkeypatch):
    store, shot = ShardStore(tmp_path), shots(0.6)[1]
    monkeypatch.setattr(ShardStore, "photograph", lambda *_: shot.taken)
    [view] = training.training_views(sheets(), texels_of(sheets(), SIZE), [shot.view], store)
    view.memory.free = room
    kept = shot.look()
    view.keep(view.fragments(), kept.colours)
    assert len(list(tmp_path.iterdir())) == (0 if room else 1)
    monkeypatch.setattr(training, "fragments_of", None)  # what was found once is not looked for again
    found = view.look()
    assert view.deepest() == kept.fragments.deepest == 2
    for name in ("ray", "texels", "shares"):
        np.testing.assert_array_equal(getattr(found.fragments, name), getattr(kept.fragments, name))
    assert found.fragments.rays == kept.fragments.rays and found.photograph is shot.taken
    np.testing.assert_array_equal(found.colours, kept.colours)
    store.remove_looks()
    assert not list(tmp_path.iterdir())
