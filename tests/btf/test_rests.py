"""What is left for the components: captured colours without lobes and hues, moved highlights cut off; put away, and cleared."""

import numpy as np
import pytest

from farfield.addon.core.btf.broad_suns import BroadSuns
from farfield.addon.core.btf.photographs import Photograph
from farfield.addon.core.btf.readings import Colours
from farfield.addon.core.btf.rests import DOME_SPIKE, SPIKE, write_rests
from farfield.addon.core.btf.shards import ShardStore
from farfield.addon.core.btf.texels import Sighting
from farfield.addon.core.direction_grids import DirectionGrid
from farfield.addon.core.progress import finish
from made_atlases import made_lobes

VIEWS, LIGHTS = DirectionGrid(2), DirectionGrid(3)
SUNS = BroadSuns(LIGHTS.directions, float(LIGHTS.solid_angles.mean()))
COUNT = 40
HUES = np.random.default_rng(1).uniform(0.5, 1.5, (COUNT, 3)).astype(np.float32)


def store_of(folder, lobes, more: float) -> ShardStore:
    """Views that see every second texel, as bright as `lobes` and `more`."""
    store = ShardStore(folder)
    store.open("bake")
    visible = np.arange(0, COUNT, 2, dtype=np.int32)
    photograph = Photograph(np.zeros((5, 2, 2, 3), np.float32), np.zeros((2, 2), np.float32))
    for number, view in enumerate(VIEWS.directions):
        radiance = lobes.of_grid(view, SUNS, visible).swapaxes(0, 1) + more
        sighting = Sighting(
            np.ones(COUNT, bool), np.ones(COUNT, np.float32), visible, np.full(len(visible), 9, np.uint8), radiance.astype(np.float32)
        )
        store.write(number, sighting, photograph, [], 1.0)
    return store


def test_without_lobes_and_hues_the_rest_is_left(tmp_path):
    lobes = made_lobes(COUNT)
    store = store_of(tmp_path, lobes, 0.1)
    rests = finish(write_rests(store, HUES, lobes, VIEWS, SUNS))
    for rest in rests:
        index, values = rest.read()
        np.testing.assert_array_equal(index, np.arange(0, COUNT, 2))
        np.testing.assert_allclose(values.reshape(20, -1, 3) * HUES[index, None], 0.1, atol=0.01)
    store.remove_rests()
    assert not list(tmp_path.glob("rest-*")) and store.stands(3)


def test_what_is_brighter_than_paper_is_cut(tmp_path):
    lobes = made_lobes(COUNT)
    rest = finish(write_rests(store_of(tmp_path, lobes, 7.0), HUES, lobes, VIEWS, SUNS))[1]
    index, values = rest.read()
    shown = values.reshape(20, -1, 3) * HUES[index, None]
    np.testing.assert_allclose(shown[:, :-1], SPIKE, rtol=0.01)
    np.testing.assert_allclose(shown[:, -1], DOME_SPIKE, rtol=0.01)


@pytest.mark.parametrize("more", [0.0, 7.0])
def test_where_there_are_no_lobes_nothing_is_cut(tmp_path, more):
    store = store_of(tmp_path, made_lobes(COUNT), more)
    rest = finish(write_rests(store, np.ones_like(HUES), None, VIEWS, SUNS))[2]
    np.testing.assert_allclose(rest.read()[1], Colours(store, 2).read()[1], rtol=1e-3)
