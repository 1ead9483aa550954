"""Finished views stand on disk whole, belong to one bake, and show when they are damaged."""

import numpy as np
import pytest

from farfield.addon.core.btf.photographs import Photograph
from farfield.addon.core.btf.readings import Colours, Domes, silhouettes
from farfield.addon.core.btf.shards import ShardStore
from farfield.addon.core.btf.texels import Sighting
from farfield.addon.core.errors import FileError
from farfield.addon.core.progress import finish


@pytest.fixture
def store(tmp_path):
    made = ShardStore(tmp_path / "Ansichten ü")
    made.open("this bake")
    return made


def sighting() -> Sighting:
    random = np.random.default_rng(0)
    visible = np.array([1, 4, 6], np.int32)
    known = np.array([True, True, False, True, True, True, True, False, True])
    coverage = np.where(known, np.rint(255.0 * random.random(9)) / 255.0, 0.0).astype(np.float32)
    return Sighting(known, coverage, visible, np.array([9, 1, 5], np.uint8), random.random((2, 3, 3)).astype(np.float32))


def photograph() -> Photograph:
    random = np.random.default_rng(1)
    return Photograph(random.normal(size=(5, 4, 4, 3)).astype(np.float32), random.random((4, 4)).astype(np.float32))


def test_photographs_come_back(store):
    store.write(2, sighting(), photograph(), [], 0.0)
    np.testing.assert_allclose(store.photograph(2).colours, photograph().colours, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(store.photograph(2).coverage, photograph().coverage, atol=0.5 / 255.0 + 1e-6)


def test_what_goes_in_comes_out(store):
    kept = sighting()
    store.write(3, kept, photograph(), [], 0.5)
    visible, values = Colours(store, 3).read()
    np.testing.assert_array_equal(visible, kept.visible)
    np.testing.assert_allclose(values.reshape(3, 2, 3), kept.radiance.swapaxes(0, 1), rtol=1e-3)
    _, under_dome = Domes(store, 3).read()
    np.testing.assert_array_equal(under_dome, values[:, -3:])


def test_silhouettes_are_what_coverage_has_more_than_plain_maps(store):
    kept, plain = sighting(), np.full(9, 0.25, np.float32)
    for view in range(2):
        store.write(view, kept, photograph(), [], 0.5)
    more, counting = finish(silhouettes(store, plain, np.array([1.0, 3.0]))).read(slice(2, None))
    np.testing.assert_array_equal(counting, kept.known[2:] * np.array([[1.0], [3.0]]))
    np.testing.assert_allclose((more + 0.25)[:, kept.known[2:]], [kept.coverage[2:][kept.known[2:]]] * 2, atol=1e-6)


def test_equal_views_are_equal_bytes(store):
    store.write(0, sighting(), photograph(), [], 1.5)
    store.write(1, sighting(), photograph(), [], 1.5)
    assert store.path(0).read_bytes() == store.path(1).read_bytes()


def test_a_damaged_view_does_not_stand(store):
    assert not store.stands(0)
    store.write(0, sighting(), photograph(), [], 1.5)
    assert store.stands(0)
    whole = bytearray(store.path(0).read_bytes())
    whole[len(whole) // 2] ^= 0xFF
    store.path(0).write_bytes(whole)
    assert not store.stands(0)
    store.path(0).write_bytes(whole[:50])
    assert not store.stands(0)


def test_faces_wait_for_the_rest_of_their_view(store):
    faces = np.arange(-1, 35, dtype=np.int32).reshape(6, 6)
    store.write_faces(2, faces)
    np.testing.assert_array_equal(store.read_faces(2), faces)
    assert not store.stands(2)


def test_nothing_but_whole_files_is_left(store):
    store.write_faces(0, np.zeros((2, 2), np.int32))
    store.write(0, sighting(), photograph(), [], 1.5)
    assert {path.name for path in store.folder.iterdir()} == {"job.json", "view-0000.json", "view-0000.shard"}


def test_the_folder_of_another_bake_is_refused(store):
    store.open("this bake")
    with pytest.raises(FileError, match="another cloud"):
        store.open("that bake")


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    with pytest.raises(FileError, match="file"):
        ShardStore(tmp_path / "file").open("x")
