"""Cameras from files: text equals binary, and damaged files are one sentence."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import FarfieldError, FileError
from farfield.addon.core.photos.importers import read_cameras
from farfield.addon.core.photos.importers.colmap import MODEL_NUMBERS

SCEAUX = Path(__file__).resolve().parents[3] / "shared" / "data" / "sceaux"
LENSES = {  # parameters as in the files
    1: ("SIMPLE_RADIAL", 640, 480, (500.0, 320.0, 240.0, 0.02)),
    7: ("OPENCV", 800, 600, (610.0, 612.0, 401.0, 299.0, 0.1, -0.05, 0.001, -0.002)),
}
NAMES = ("küche 2/IMG 0001.jpg", "a.png", "日本.tif")


def random_images(seed=0):
    """ID, quaternion, translation, camera and name of each image."""
    random = np.random.default_rng(seed)
    return [(index + 1, random.normal(size=4), random.normal(size=3), (1, 7, 7)[index], name) for index, name in enumerate(NAMES)]


def write_text(folder, images):
    lines = ["# Camera list"]
    lines += [
        f"{number} {model} {width} {height} {' '.join(map(repr, values))}" for number, (model, width, height, values) in LENSES.items()
    ]
    (folder / "cameras.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    lines = ["# Image list"]
    for number, quaternion, translation, lens, name in images:
        lines.append(f"{number} {' '.join(repr(float(v)) for v in (*quaternion, *translation))} {lens} {name}")
        lines.append("10.5 20.5 -1 30.0 40.0 5" if number % 2 else "")
    (folder / "images.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_binary(folder, images):
    data = struct.pack("<Q", len(LENSES))
    for number, (model, width, height, values) in LENSES.items():
        data += struct.pack(f"<iiQQ{len(values)}d", number, MODEL_NUMBERS.index(model), width, height, *values)
    (folder / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", len(images))
    for number, quaternion, translation, lens, name in images:
        data += struct.pack("<i7di", number, *quaternion, *translation, lens) + name.encode() + b"\0"
        points = [(10.5, 20.5, -1), (30.0, 40.0, 5)] if number % 2 else []
        data += struct.pack("<Q", len(points)) + b"".join(struct.pack("<ddq", *point) for point in points)
    (folder / "images.bin").write_bytes(data)


@pytest.mark.parametrize("write", [write_text, write_binary])
@pytest.mark.parametrize("subfolder", ["", "sparse/0"])
def test_cameras_are_those_of_the_file(tmp_path, write, subfolder):
    folder = tmp_path / subfolder
    folder.mkdir(parents=True, exist_ok=True)
    images = random_images()
    write(folder, images)
    cameras = {camera.name: camera for camera in read_cameras(tmp_path)}
    assert set(cameras) == set(NAMES)
    points = np.random.default_rng(1).normal(size=(50, 3))
    for _, quaternion, translation, lens, name in images:
        w, *axis = quaternion / np.linalg.norm(quaternion)
        turned = points + 2.0 * np.cross(axis, np.cross(axis, points) + w * points)  # by the quaternion
        local = turned + translation
        model, width, height, values = LENSES[lens]
        assert cameras[name].lens.size == (width, height) and cameras[name].lens.model == model
        found, depths, _ = cameras[name].project(points)
        assert depths == pytest.approx(local[:, 2])
        u, v = (local[:, :2] / local[:, 2:]).T
        square = u * u + v * v
        if model == "SIMPLE_RADIAL":
            f, cx, cy, k = values
            x, y = f * u * (1 + k * square) + cx, f * v * (1 + k * square) + cy
        else:
            fx, fy, cx, cy, k1, k2, p1, p2 = values
            radial = 1 + k1 * square + k2 * square**2
            x = fx * (u * radial + 2 * p1 * u * v + p2 * (square + 2 * u * u)) + cx
            y = fy * (v * radial + 2 * p2 * u * v + p1 * (square + 2 * v * v)) + cy
        seen = cameras[name].project(points)[2]
        assert np.abs(found - np.stack([x, height - y], axis=1))[seen].max(initial=0.0) < 1e-6


def test_text_equals_binary(tmp_path):
    for name, write in (("text", write_text), ("binary", write_binary)):
        (tmp_path / name).mkdir()
        write(tmp_path / name, random_images(2))
    text, binary = (read_cameras(tmp_path / name) for name in ("text", "binary"))
    for first, second in zip(text, binary, strict=True):
        assert first.name == second.name and first.lens == second.lens
        assert (first.rotation == second.rotation).all() and (first.translation == second.translation).all()


@pytest.mark.parametrize("write", [write_text, write_binary])
@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_damaged_files_are_one_sentence_or_cameras(tmp_path_factory, write, seed):
    folder = tmp_path_factory.mktemp("damaged")
    write(folder, random_images(3))
    random = np.random.default_rng(seed)
    path = sorted(folder.iterdir())[random.integers(2)]
    data = bytearray(path.read_bytes())
    if random.random() < 0.5:
        data = data[: random.integers(len(data))]
    else:
        for index in random.integers(0, len(data), 3):
            data[index] = random.integers(256)
    path.write_bytes(data)
    try:
        assert read_cameras(folder)
    except FarfieldError as error:
        assert "\n" not in str(error)


def test_missing_cameras_are_one_sentence(tmp_path):
    with pytest.raises(FileError, match="There are no cameras in"):
        read_cameras(tmp_path)
    write_text(tmp_path, [])
    with pytest.raises(FileError, match="no registered image"):
        read_cameras(tmp_path)
    write_text(tmp_path, [(1, np.ones(4), np.zeros(3), 5, "a.jpg")])
    with pytest.raises(FileError, match="has the camera 5, which does not exist"):
        read_cameras(tmp_path)
    write_text(tmp_path, [(1, np.zeros(4), np.zeros(3), 1, "a.jpg")])
    with pytest.raises(FileError, match="has no rotation"):
        read_cameras(tmp_path)


@pytest.mark.skipif(not SCEAUX.is_dir(), reason="needs the photographs of Sceaux")
def test_real_cameras_look_at_their_mesh():
    cameras = read_cameras(SCEAUX)
    assert len(cameras) == 10
    centers = [camera.position for camera in cameras]
    point = np.mean(centers, axis=0) + 6.0 * np.mean([camera.rotation[2] for camera in cameras], axis=0)
    for camera in cameras:
        (position,), _, is_valid = camera.project(point[None])
        assert is_valid.all() and (position > 0).all() and (position < camera.lens.size).all()
