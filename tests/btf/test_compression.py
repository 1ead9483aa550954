"""Compression preserves suns in front of a bright dome, and weights texels by their visible area."""

import numpy as np
import pytest

from farfield.addon.core.billboards.texels import QuadPolygons, Texels, texels_under_quads
from farfield.addon.core.btf.capture.observations import SUBSAMPLES, Observation, ReferenceImage
from farfield.addon.core.btf.capture.shards import ShardStore
from farfield.addon.core.btf.compression import LevelCompressor
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.jobs.progress import run_to_end

SIDE = 24
SETTINGS = BtfSettings(views_per_side=3, lights_per_side=3, components=3, alpha_components=1, shadows_per_side=0, refine=False)
VIEWS, SUNS = 9, 9
FULLY_SEEN = SUBSAMPLES**2


def square_texels() -> Texels:
    """Return the texels of one quad that faces up."""
    corners = np.array([[0, 0], [SIDE, 0], [SIDE, SIDE], [0, SIDE]], float)
    quads = QuadPolygons([np.column_stack([corners, np.zeros(4)])], [corners + 1.0])
    return texels_under_quads(quads, (SIDE + 2, SIDE + 2))


def write_store(folder, luminance: np.ndarray, subsample_counts: np.ndarray) -> ShardStore:
    """Write views of all texels: gray colors `luminance` (V, L + 1, N), and `subsample_counts` (V, N)."""
    store, count = ShardStore(folder), luminance.shape[2]
    store.open("bake")
    reference = ReferenceImage(np.zeros((5, 2, 2, 3), np.float32), np.zeros((2, 2), np.float32))
    for view in range(VIEWS):
        radiance = np.repeat(luminance[view, :, :, None], 3, axis=2).astype(np.float32)
        coverage = np.ones(count, np.float32)
        counts = subsample_counts[view].astype(np.uint8)
        observation = Observation(coverage > 0.0, coverage, np.arange(count, dtype=np.int32), counts, radiance)
        store.write(view, observation, reference, [], 1.0)
    return store


def compress_and_decode(store: ShardStore, view: int) -> np.ndarray:
    """Return the decoded colors (N, L + 1) of a view, averaged over the channels."""
    texels = square_texels()
    compressor = LevelCompressor(store, texels, np.ones(len(texels)), None, SETTINGS)
    return compressor.decoded_colors(run_to_end(compressor.compress()), view, np.arange(len(texels))).mean(axis=2)


@pytest.mark.parametrize("brightness", [1.0, 10.0, 100.0])
def test_a_bright_dome_does_not_use_up_the_components(tmp_path, brightness):
    """The suns have rank two; the dome is noise of any brightness."""
    random, count = np.random.default_rng(0), len(square_texels())
    suns = np.einsum("vlk,kn->vln", random.random((VIEWS, SUNS, 2)), random.random((2, count)))
    dome = brightness * random.random((VIEWS, 1, count))
    store = write_store(tmp_path, np.concatenate([suns, dome], axis=1), np.full((VIEWS, count), FULLY_SEEN))
    decoded = compress_and_decode(store, 4)[:, :-1].T
    assert decoded.sum() == pytest.approx(suns[4].sum(), rel=0.02)
    assert np.sqrt(((decoded - suns[4]) ** 2).mean()) < 0.5 * suns[4].std()


def test_captured_colors_are_those_of_the_view(tmp_path):
    random, count = np.random.default_rng(2), len(square_texels())
    luminance = random.random((VIEWS, SUNS + 1, count))
    store = write_store(tmp_path, luminance, np.full((VIEWS, count), FULLY_SEEN))
    rows, colors = LevelCompressor(store, square_texels(), np.ones(count), None, SETTINGS).captured_colors(3)
    np.testing.assert_array_equal(rows, np.arange(count))
    np.testing.assert_allclose(colors, np.repeat(luminance[3].T[..., None], 3, axis=2), rtol=1e-3)


def test_partly_seen_texels_have_little_weight(tmp_path):
    """Three views show some texels ten times too bright; with few subsamples, the components follow the other views."""
    random, count = np.random.default_rng(1), len(square_texels())
    truth = np.einsum("vlk,kn->vln", random.random((VIEWS, SUNS + 1, 3)), random.random((3, count)))
    luminance, counts = truth.copy(), np.full((VIEWS, count), FULLY_SEEN)
    wrong_texels = random.permutation(count)[: count // 4]
    errors = {}
    for seen in (1, FULLY_SEEN):
        counts[:3, wrong_texels], luminance[:3, :, wrong_texels] = seen, 10.0 * random.random((3, SUNS + 1, len(wrong_texels)))
        decoded = compress_and_decode(write_store(tmp_path / str(seen), luminance, counts), 6).T
        errors[seen] = np.abs(decoded - truth[6])[:, wrong_texels].mean()
    assert errors[1] < 0.7 * errors[FULLY_SEEN]
