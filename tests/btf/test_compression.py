"""What compression keeps: suns beside a bright dome, and what is seen clearly beside what is hardly seen."""

import numpy as np
import pytest

from farfield.addon.core.btf.compression import Compression
from farfield.addon.core.btf.photographs import Photograph
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.btf.shards import ShardStore
from farfield.addon.core.btf.texels import PARTS, Quads, Sighting, texels_of
from farfield.addon.core.progress import finish

SIDE = 24
SETTINGS = BtfSettings(views=9, lights=9, components=3, alpha_components=1, shadows=0, refine=False)
VIEWS, SUNS = 9, 9
WHOLE = PARTS**2


def square():
    """The texels of one quad, which faces up."""
    corners = np.array([[0, 0], [SIDE, 0], [SIDE, SIDE], [0, SIDE]], float)
    return texels_of(Quads([np.column_stack([corners, np.zeros(4)])], [corners + 1.0]), (SIDE + 2, SIDE + 2))


def store_of(folder, colours: np.ndarray, parts: np.ndarray) -> ShardStore:
    """Views that see all texels: `colours` (V, L + 1, N), grey, by `parts` (V, N)."""
    store, count = ShardStore(folder), colours.shape[2]
    store.open("bake")
    photograph = Photograph(np.zeros((5, 2, 2, 3), np.float32), np.zeros((2, 2), np.float32))
    for view in range(VIEWS):
        radiance = np.repeat(colours[view, :, :, None], 3, axis=2).astype(np.float32)
        everywhere = np.ones(count, np.float32)
        sighting = Sighting(everywhere > 0.0, everywhere, np.arange(count, dtype=np.int32), parts[view].astype(np.uint8), radiance)
        store.write(view, sighting, photograph, [], 1.0)
    return store


def compressed(store: ShardStore, view: int) -> np.ndarray:
    """What the compressed colours (N, L + 1) show from a view, in the mean of their channels."""
    texels = square()
    compression = Compression(store, texels, np.ones(len(texels)), None, SETTINGS)
    return compression.shown(finish(compression.compress()), view, np.arange(len(texels))).mean(axis=2)


@pytest.mark.parametrize("brightness", [1.0, 10.0, 100.0])
def test_a_bright_dome_leaves_suns_their_components(tmp_path, brightness):
    """Suns are two components of everything; the dome is noise, however bright."""
    random, count = np.random.default_rng(0), len(square())
    suns = np.einsum("vlk,kn->vln", random.random((VIEWS, SUNS, 2)), random.random((2, count)))
    dome = brightness * random.random((VIEWS, 1, count))
    shown = compressed(store_of(tmp_path, np.concatenate([suns, dome], axis=1), np.full((VIEWS, count), WHOLE)), 4)[:, :-1].T
    assert shown.sum() == pytest.approx(suns[4].sum(), rel=0.02)
    assert np.sqrt(((shown - suns[4]) ** 2).mean()) < 0.5 * suns[4].std()


def test_captured_colours_are_those_of_the_view(tmp_path):
    random, count = np.random.default_rng(2), len(square())
    colours = random.random((VIEWS, SUNS + 1, count))
    store = store_of(tmp_path, colours, np.full((VIEWS, count), WHOLE))
    rows, captured = Compression(store, square(), np.ones(count), None, SETTINGS).captured(3)
    np.testing.assert_array_equal(rows, np.arange(count))
    np.testing.assert_allclose(captured, np.repeat(colours[3].T[..., None], 3, axis=2), rtol=1e-3)


def test_what_is_hardly_seen_counts_little(tmp_path):
    """Three views see parts of texels, and see them ten times as bright; the components follow the others."""
    random, count = np.random.default_rng(1), len(square())
    right = np.einsum("vlk,kn->vln", random.random((VIEWS, SUNS + 1, 3)), random.random((3, count)))
    colours, parts = right.copy(), np.full((VIEWS, count), WHOLE)
    hardly = random.permutation(count)[: count // 4]
    errors = {}
    for seen in (1, WHOLE):
        parts[:3, hardly], colours[:3, :, hardly] = seen, 10.0 * random.random((3, SUNS + 1, len(hardly)))
        shown = compressed(store_of(tmp_path / str(seen), colours, parts), 6).T
        errors[seen] = np.abs(shown - right[6])[:, hardly].mean()
    assert errors[1] < 0.7 * errors[WHOLE]
