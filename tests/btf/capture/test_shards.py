"""Finished views are complete files of one bake, and damage is detected."""

import numpy as np
import pytest

from farfield.addon.core.btf.capture.observations import Observation
from farfield.addon.core.btf.capture.reference_images import ReferenceImage
from farfield.addon.core.btf.capture.shards import ShardStore
from farfield.addon.core.btf.capture.view_data import DomeView, RadianceView, read_silhouettes
from farfield.addon.core.errors import FileError
from farfield.addon.core.jobs.progress import run_to_end


@pytest.fixture
def store(tmp_path):
    store = ShardStore(tmp_path / "Ansichten ü")
    store.open("this bake")
    return store


def random_observation() -> Observation:
    random = np.random.default_rng(0)
    visible = np.array([1, 4, 6], np.int32)
    known = np.array([True, True, False, True, True, True, True, False, True])
    coverage = np.where(known, np.rint(255.0 * random.random(9)) / 255.0, 0.0).astype(np.float32)
    return Observation(known, coverage, visible, np.array([9, 1, 5], np.uint8), random.random((2, 3, 3)).astype(np.float32))


def random_reference() -> ReferenceImage:
    random = np.random.default_rng(1)
    return ReferenceImage(random.normal(size=(5, 4, 4, 3)).astype(np.float32), random.random((4, 4)).astype(np.float32))


def test_reference_images_round_trip(store):
    store.write(2, random_observation(), random_reference(), [], 0.0)
    np.testing.assert_allclose(store.read_reference(2).colors, random_reference().colors, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(store.read_reference(2).coverage, random_reference().coverage, atol=0.5 / 255.0 + 1e-6)


def test_radiance_round_trips(store):
    observation = random_observation()
    store.write(3, observation, random_reference(), [], 0.5)
    visible, values = RadianceView(store, 3).read()
    np.testing.assert_array_equal(visible, observation.visible)
    np.testing.assert_allclose(values.reshape(3, 2, 3), observation.radiance.swapaxes(0, 1), rtol=1e-3)
    _, dome_values = DomeView(store, 3).read()
    np.testing.assert_array_equal(dome_values, values[:, -3:])


def test_silhouettes_are_the_difference_of_coverage_and_pbr_alpha(store):
    observation, pbr_alpha = random_observation(), np.full(9, 0.25, np.float32)
    for view in range(2):
        store.write(view, observation, random_reference(), [], 0.5)
    values, weights = run_to_end(read_silhouettes(store, pbr_alpha, np.array([1.0, 3.0]))).read(slice(2, None))
    known = observation.known[2:]
    np.testing.assert_array_equal(weights, known * np.array([[1.0], [3.0]]))
    np.testing.assert_allclose((values + 0.25)[:, known], [observation.coverage[2:][known]] * 2, atol=1e-6)


def test_equal_views_have_equal_bytes(store):
    store.write(0, random_observation(), random_reference(), [], 1.5)
    store.write(1, random_observation(), random_reference(), [], 1.5)
    assert store.path(0).read_bytes() == store.path(1).read_bytes()


def test_a_damaged_view_is_not_valid(store):
    assert not store.is_valid(0)
    store.write(0, random_observation(), random_reference(), [], 1.5)
    assert store.is_valid(0)
    content = bytearray(store.path(0).read_bytes())
    content[len(content) // 2] ^= 0xFF
    store.path(0).write_bytes(content)
    assert not store.is_valid(0)
    store.path(0).write_bytes(content[:50])
    assert not store.is_valid(0)


def test_an_id_buffer_alone_is_no_finished_view(store):
    face_ids = np.arange(-1, 35, dtype=np.int32).reshape(6, 6)
    store.face_ids.write(2, face_ids)
    np.testing.assert_array_equal(store.face_ids.read(2), face_ids)
    assert not store.is_valid(2)


def test_only_files_of_finished_views_remain(store):
    store.face_ids.write(0, np.zeros((2, 2), np.int32))
    store.write(0, random_observation(), random_reference(), [], 1.5)
    assert {path.name for path in store.folder.iterdir()} == {"job.json", "view-0000.json", "view-0000.shard"}


def test_the_folder_of_another_bake_is_rejected(store):
    store.open("this bake")
    with pytest.raises(FileError, match="another cloud"):
        store.open("that bake")


def test_a_folder_that_cannot_be_created_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    with pytest.raises(FileError, match="file"):
        ShardStore(tmp_path / "file").open("x")
