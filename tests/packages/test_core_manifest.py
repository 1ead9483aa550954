"""Manifests and tables of increments: round trips, and refusal of what is damaged or contradicts itself."""

import json
import os
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import FileError
from farfield.addon.core.packages.increments import Increments, decode_increments, encode_increments
from farfield.addon.core.packages.manifest import (
    MAX_MANIFEST_BYTES,
    Manifest,
    MeshLevel,
    PackageMaterial,
    PackageTexture,
    Section,
    decode_manifest,
    encode_manifest,
    find_origin,
    read_manifest,
)
from farfield.addon.core.packages.planning import ErrorModel


def make_manifest() -> Manifest:
    sections = [Section(10 * index, 10, index) for index in range(10)]
    return Manifest(
        name="Kürbis",
        files={"mesh.bin": (100, "00"), "textures.bin": (500, "11")},
        mirrors=("https://example.org/pumpkin/",),
        bounds=((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)),
        uv_bounds=((0.0, 0.0), (1.0, 1.0)),
        steps=(8191, 4095),
        levels=(MeshLevel(4, 5, (4,), *sections[:5], 16.0), MeshLevel(8, 9, (12,), *sections[5:], 0.0)),
        materials=(PackageMaterial("skin", (1.0, 1.0, 1.0, 1.0), {"base_color": 0}, False),),
        textures=(PackageTexture("base_color", 300, 200, 128, (b"\xff\xd8", b"\xff\xd9")),),
        increment_count=3,
        increments=Section(0, 20, 7),
        checksums=Section(20, 12, 8),
        first_increment=32,
        errors=ErrorModel((0.3, 0.0), (0.25, 0.05), 2.0),
        state_pixels=(100.0, 0.0),
        time_limit=5.0,
        pixels=512.0,
    )


def test_manifest_survives_json():
    assert decode_manifest(encode_manifest(make_manifest())) == make_manifest()


def test_tiles_of_all_levels_count():
    assert make_manifest().textures[0].tile_count == 2 * 3 + 1 * 2 + 1 + 2


def test_mesh_size_is_that_of_a_level_and_all_coarser_ones():
    assert make_manifest().mesh_size(0) == 50
    assert make_manifest().mesh_size(1) == 100


@pytest.mark.parametrize(
    "change",
    [
        {"files": {"mesh.bin": (99, "00"), "textures.bin": (500, "11")}},
        {"files": {"mesh.bin": (100, "00")}},
        {"files": {"mesh.bin": (100, "00"), "textures.bin": (31, "11")}},
        {"levels": ()},
        {"steps": (0, 4095)},
        {"steps": (8191, 65536)},
        {"errors": ErrorModel((), (0.2,), 2.0)},
        {"errors": ErrorModel((0.3, 0.0), (), 2.0)},
        {"errors": ErrorModel((0.3,), (0.2, 0.1), 2.0)},
        {"errors": ErrorModel((0.3, 0.31), (0.2, 0.1), 2.0)},
        {"errors": ErrorModel((0.3, 0.2), (0.1, 0.2), 2.0)},
        {"errors": ErrorModel((0.3, -0.1), (0.2, 0.1), 2.0)},
        {"errors": ErrorModel((1.3, 0.1), (0.2, 0.1), 2.0)},
        {"errors": ErrorModel((0.3, 0.1), (0.2, 0.1), 0.5)},
        {"errors": ErrorModel((0.3, 0.1), (0.1,) * 65, 2.0)},
        {"time_limit": 0.0},
        {"materials": (PackageMaterial("skin", (1.0, 1.0, 1.0, 1.0), {"base_color": 1}, False),)},
        {"textures": (PackageTexture("base_color", 3000, 200, 1, (b"\xff",)),)},
        {"textures": (PackageTexture("base_color", 0, 200, 128, (b"\xff",)),)},
        {"increments": Section(20, 20, 7)},
        {"increment_count": 469},
        {"increment_count": 1},
        {"increment_count": 0},
    ],
)
def test_contradictions_are_refused(change):
    with pytest.raises(FileError, match="contradicts itself"):
        decode_manifest(encode_manifest(replace(make_manifest(), **change)))


def test_newer_version_is_refused():
    content = json.loads(encode_manifest(make_manifest()))
    with pytest.raises(FileError, match="update Farfield"):
        decode_manifest(json.dumps(content | {"version": 5}).encode())


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (["name"], "\ud800"),
        (["name"], 5),
        (["name"], "a" * 2000),
        (["mirrors", 0], "\udfff"),
        (["materials", 0, "name"], "\ud800"),
        (["files", "\ud800"], [1, ""]),
        (["steps"], "ab"),
        (["steps", 0], True),
        (["bounds", 0], "123"),
        (["bounds", 0, 0], "1"),
        (["bounds", 0, 0], float("nan")),
        (["bounds", 0, 0], 1e300),
        (["bounds", 0, 0], 10**400),
        (["version"], None),
    ],
)
def test_values_of_another_type_or_out_of_range_are_damaged(path, value):
    content = json.loads(encode_manifest(make_manifest()))
    place = content
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(FileError, match="is damaged; export the package again"):
        decode_manifest(json.dumps(content).encode())


@pytest.mark.parametrize(
    ("url", "origin"),
    [
        ("https://example.org/", "https://example.org"),
        ("http://127.0.0.1:8000/a/b/", "http://127.0.0.1:8000"),
        ("https://[::1]:443/x/", "https://[::1]:443"),
        ("https://müller.example/größe/", "https://xn--mller-kva.example"),
    ],
)
def test_the_origin_of_a_mirror(url, origin):
    assert find_origin(url) == origin


@pytest.mark.parametrize(
    "url",
    [
        *("", "/", "copies/", "//example.org/", "https:///", "https://example.org", "ftp://example.org/", "javascript:alert(1)/"),
        *("https://example.org;script-src *//", "https://a b/", 'https://a">/', "https://user:word@example.org/", "https://a:99999999/"),
        *("https://*/", "https://a,b/", "https://'self'/", "https://[::1/", "https://" + "a" * 100 + ".example/"),
    ],
)
def test_a_mirror_that_is_no_folder_on_a_web_server_is_refused(url):
    with pytest.raises(ValueError):
        find_origin(url)
    content = json.loads(encode_manifest(make_manifest())) | {"mirrors": [url]}
    with pytest.raises(FileError, match="is damaged"):
        decode_manifest(json.dumps(content).encode())


def test_deeply_nested_json_is_damaged():
    with pytest.raises(FileError, match="is damaged"):
        decode_manifest(b"[" * 1_000_000)


def test_as_many_increments_as_bytes_are_possible():
    assert decode_manifest(encode_manifest(replace(make_manifest(), increment_count=468))).increment_count == 468


@pytest.mark.skipif(os.name == "nt", reason="Windows has no named pipes in folders")
def test_a_manifest_that_is_a_device_a_pipe_or_too_large_is_refused(tmp_path):
    (tmp_path / "manifest.json").symlink_to("/dev/zero")
    with pytest.raises(FileError, match="is a device or a pipe"):
        read_manifest(tmp_path)
    (tmp_path / "manifest.json").unlink()
    os.mkfifo(tmp_path / "manifest.json")
    with pytest.raises(FileError, match="is a device or a pipe"):
        read_manifest(tmp_path)
    (tmp_path / "manifest.json").unlink()
    with (tmp_path / "manifest.json").open("wb") as file:
        file.truncate(MAX_MANIFEST_BYTES + 1)  # a file without content, which needs no room on the disk
    with pytest.raises(FileError, match="has more than"):
        read_manifest(tmp_path)
    with pytest.raises(FileError, match="choose a shorter name"):
        read_manifest(tmp_path / ("a" * 300))


@given(st.data())
def test_damaged_json_is_refused_or_still_a_manifest(data):
    content = bytearray(encode_manifest(make_manifest()))
    content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    with suppress(FileError):
        assert isinstance(decode_manifest(bytes(content)), Manifest)


@pytest.mark.slow
@settings(max_examples=40)
@given(st.recursive(st.none() | st.booleans() | st.floats() | st.text(), lambda item: st.lists(item) | st.dictionaries(st.text(), item)))
def test_other_json_is_refused(value):
    for content in (value, {"format": "farfield-package", "version": 4, "levels": value}):
        with pytest.raises(FileError):
            decode_manifest(json.dumps(content).encode())


def make_increments() -> Increments:
    return Increments(
        np.array([0, 0, 0]),
        np.array([5, 2, 5]),
        np.array([1, 0, 1]),
        np.array([300, 70, 98]),
        np.array([0, 0, 1]),
        np.array([1, 0, 1]),
    )


def test_increments_survive():
    found = decode_increments(encode_increments(make_increments()), make_manifest())
    for name, values in vars(make_increments()).items():
        np.testing.assert_array_equal(getattr(found, name), values)


def test_states_are_what_their_increments_say():
    increments = make_increments()
    assert increments.state_count == 2
    assert increments.are_in(0).tolist() == [True, True, False]
    assert increments.are_in(1).tolist() == [True, False, True]
    assert increments.measure_states(2) == [370, 398]


@pytest.mark.parametrize(
    "change",
    [
        {"tiles": np.array([11, 2, 5])},
        {"headers": np.array([2, 0, 1])},
        {"sizes": np.array([300, 70, 99])},
        {"firsts": np.array([0, 1, 0])},
        {"firsts": np.array([0, 0, 0])},
        {"lasts": np.array([1, 0, 0])},
        {"lasts": np.array([1, 0, 2])},
    ],
)
def test_impossible_increments_are_refused(change):
    with pytest.raises(FileError):
        decode_increments(encode_increments(replace(make_increments(), **change)), make_manifest())


@given(st.binary(max_size=80))
def test_random_tables_are_refused(content):
    with pytest.raises(FileError):
        decode_increments(content, make_manifest())


def test_sections_are_checked():
    content = bytes(range(50))
    with pytest.raises(FileError, match="damaged at byte 40"):
        Section(40, 11, 0).read(content, "mesh.bin")
    with pytest.raises(FileError):
        Section(40, 10, 0).read(content, "mesh.bin")
