"""Finished views are complete files of one bake, and damage is detected."""

import errno
import hashlib
import io
import os
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from farfield.addon.core.btf.capture import shard_files
from farfield.addon.core.btf.capture.observations import Observation, ReferenceImage
from farfield.addon.core.btf.capture.shards import ShardLayout, ShardStore
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


def test_an_id_buffer_alone_is_not_a_finished_view(store):
    face_ids = np.arange(-1, 35, dtype=np.int32).reshape(6, 6)
    store.face_ids.write(2, {"face_ids": face_ids}, compressed=True)
    np.testing.assert_array_equal(store.face_ids.read(2, "face_ids")[0], face_ids)
    assert not store.is_valid(2)


def test_only_files_of_finished_views_remain(store):
    store.face_ids.write(0, {"face_ids": np.zeros((2, 2), np.int32)})
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


def test_views_without_shadow_directions_are_read_with_the_others(store):
    """Three views share two shadow directions, so the last one holds none."""
    rows = np.array([[0, 1, 2, 3, 4, 5, 6, 7, 8], [9, 8, 7, 6, 5, 4, 3, 2, 1]], np.uint8)
    for view, visibility in enumerate(([rows[0]], [rows[1]], [])):
        store.write(view, random_observation(), random_reference(), visibility, 0.0)
    np.testing.assert_array_equal(store.read_visibility(3), rows)


LAYOUT = ShardLayout(texel_count=9, image_count=2, reference_count=5, resolution=4, view_count=3, shadow_count=2)


def stored_arrays() -> dict[str, np.ndarray]:
    """The arrays of view 1 of LAYOUT as they are stored."""
    observation, reference = random_observation(), random_reference()
    return {
        "known": np.packbits(observation.known),
        "coverage": np.zeros(9, np.uint8),
        "visible": observation.visible,
        "subsample_counts": observation.subsample_counts,
        "radiance": observation.radiance.astype(np.float16),
        "emission": np.zeros((0, 3), np.float16),
        "reference_colors": reference.colors.astype(np.float16),
        "reference_coverage": np.zeros((4, 4), np.uint8),
        "visibility": np.zeros((1, 9), np.uint8),
    }


def changed(array: np.ndarray, index, value) -> np.ndarray:
    array = array.copy()
    array[index] = value
    return array


def test_a_view_that_matches_its_layout_is_valid(store):
    store = replace(store, layout=LAYOUT)
    for view, visibility in enumerate(([np.zeros(9, np.uint8)], [np.ones(9, np.uint8)], [])):
        store.write(view, random_observation(), random_reference(), visibility, 0.0)
        assert store.is_valid(view)
    store._files.write(1, stored_arrays())
    assert store.validate_or_remove(1)


@pytest.mark.parametrize(
    "changes",
    [
        {"coverage": np.zeros(8, np.uint8)},
        {"coverage": np.zeros(9, np.float16)},
        {"coverage": np.array([b"a"] * 9)},
        {"visible": np.array([1, 4, 9], np.int32)},
        {"visible": np.array([-1, 4, 6], np.int32)},
        {"visible": np.array([4, 4, 6], np.int32)},
        {"visible": np.array(3, np.int32)},
        {"subsample_counts": np.array([9, 10, 5], np.uint8)},
        {"radiance": changed(stored_arrays()["radiance"], (1, 2, 0), np.nan)},
        {"radiance": changed(stored_arrays()["radiance"], (1, 2, 0), np.inf)},
        {"radiance": np.zeros((3, 3, 3), np.float16)},
        {"emission": np.zeros((2, 3), np.float16)},
        {"emission": np.float16(1.0)},
        {"reference_colors": np.zeros((5, 5, 5, 3), np.float16)},
        {"visibility": np.zeros((2, 9), np.uint8)},
        {"visibility": None},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_a_view_that_does_not_match_its_layout_is_removed(store, changes):
    """Its checksum is right: anyone can compute it."""
    store = replace(store, layout=LAYOUT)
    arrays = {name: array for name, array in (stored_arrays() | changes).items() if array is not None}
    store._files.write(1, arrays)
    assert replace(store, layout=None).is_valid(1)
    assert not store.validate_or_remove(1) and not store.exists(1)


def corrupt_npy(header: bytes) -> bytes:
    """Return an archive with one array "known" with this header and no data."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("known.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    return buffer.getvalue()


def lying_directory() -> bytes:
    """Return an archive whose directory promises 4 GiB."""
    content = bytearray(corrupt_npy(b"{}"))
    entry = content.rindex(b"PK\x01\x02")
    content[entry + 20 : entry + 28] = b"\xf0\xff\xff\xff" * 2
    return bytes(content)


def unknown_method() -> bytes:
    content = bytearray(corrupt_npy(b"{}"))
    content[content.rindex(b"PK\x01\x02") + 10] = content[8] = 99
    return bytes(content)


def damaged_deflate() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("known.npy", np.random.default_rng(0).bytes(500))
    content = bytearray(buffer.getvalue())
    content[60:90] = b"\xff" * 30
    return bytes(content)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"no archive",
        corrupt_npy(b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000)}"),
        corrupt_npy(b"{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 0)}"),
        corrupt_npy(b"{'descr': '|O', 'fortran_order': False, 'shape': (0,)}"),
        corrupt_npy(b"(" * 9000),
        corrupt_npy(b"{'descr': [], 'fortran_order': 1"),
        lying_directory(),
        unknown_method(),
        damaged_deflate(),
    ],
    ids=["empty", "text", "huge", "negative", "objects", "nested", "cut", "directory", "method", "deflate"],
)
def test_damaged_archives_are_not_finished_views(store, content):
    """Also if their checksum is right."""
    store.path(0).write_bytes(hashlib.sha256(content).digest() + content)
    with pytest.raises(FileError, match=r"cannot be read: .*finished views are reused"):
        store.read(0, "known")
    assert not replace(store, layout=LAYOUT).validate_or_remove(0) and not store.exists(0)


@pytest.mark.parametrize("content", ["[]", "null", '"a"', "[" * 200_000, "{}", "\x00"])
def test_the_folder_of_a_damaged_bake_is_rejected(store, content):
    (store.folder / "job.json").write_text(content, encoding="utf-8")
    with pytest.raises(FileError, match="another cloud"):
        store.open("this bake")


@pytest.mark.parametrize(("code", "advice"), [(errno.ENOSPC, "free some space there"), (errno.EACCES, "change its permissions")])
def test_a_view_that_cannot_be_saved_is_one_sentence(store, monkeypatch, code, advice):
    def fail(path, content):
        raise OSError(code, os.strerror(code), str(path))

    monkeypatch.setattr(shard_files, "write_bytes_atomically", fail)
    with pytest.raises(FileError, match=f"Finished views are kept, but this one cannot be saved as .*{advice}"):
        store.write(0, random_observation(), random_reference(), [], 0.0)


def test_folders_in_the_place_of_files_are_named(store):
    for name in (store.path(0).name, "view-0001.4711.part"):
        (store.folder / name / "folder").mkdir(parents=True)
    store.remove_temporary_files()
    assert not store.exists(0) and not store.is_valid(0)
    with pytest.raises(FileError, match=r"view-0000\.shard\" cannot be deleted"):
        store.validate_or_remove(0)
    with pytest.raises(FileError, match=r"view-0000\.shard"):
        store.write(0, random_observation(), random_reference(), [], 0.0)


@pytest.mark.parametrize("content", ["[]", '{"render_seconds": 1e999}', '{"render_seconds": NaN}', "[" * 200_000, "{}"])
def test_unusable_render_times_are_ignored(store, content):
    for view in range(2):
        store.write(view, random_observation(), random_reference(), [], 1.5)
    (store.folder / "view-0001.json").write_text(content, encoding="utf-8")
    assert store.render_seconds(2) == 1.5
