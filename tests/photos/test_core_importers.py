"""Cameras from files: text equals binary, and damaged files are one sentence."""

import json
import struct
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import FarfieldError, FileError
from farfield.addon.core.photos.importers import read_camera_file, read_cameras
from farfield.addon.core.photos.importers.colmap import MODEL_NAMES
from random_inputs import damage

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
        data += struct.pack(f"<iiQQ{len(values)}d", number, MODEL_NAMES.index(model), width, height, *values)
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


@pytest.mark.parametrize("write", [write_text, write_binary])
def test_a_lens_that_no_model_here_has_costs_its_photographs_only(tmp_path, write, monkeypatch):
    monkeypatch.setitem(LENSES, 7, ("EUCM", 800, 600, (610.0, 612.0, 401.0, 299.0, 0.5, 1.1)))
    write(tmp_path, random_images())
    found = read_camera_file(tmp_path)
    assert [camera.name for camera in found.cameras] == [NAMES[0]]
    assert found.notes == [f'Skipped: "{NAMES[1]}", "{NAMES[2]}" (its lens model is EUCM).']


@pytest.mark.parametrize("write", [write_text, write_binary])
@pytest.mark.parametrize(("model", "values"), [("SIMPLE_FISHEYE", (610.0, 401.0, 299.0)), ("FISHEYE", (610.0, 612.0, 401.0, 299.0))])
def test_equidistant_lenses_project_angles(tmp_path, write, model, values, monkeypatch):
    monkeypatch.setitem(LENSES, 7, (model, 800, 600, values))
    write(tmp_path, random_images())
    camera = next(camera for camera in read_cameras(tmp_path) if camera.name == NAMES[1])
    angle = np.radians(50.0)
    points = np.array([[np.sin(angle), 0.0, np.cos(angle)], [0.0, np.sin(angle), np.cos(angle)]])
    positions, is_valid = camera.lens.project(points)
    assert is_valid.all()
    center = np.array([401.0, 600 - 299.0])
    assert positions == pytest.approx(np.array([center + [values[0] * angle, 0.0], center - [0.0, values[-3] * angle]]))


def test_text_equals_binary(tmp_path):
    for name, write in (("text", write_text), ("binary", write_binary)):
        (tmp_path / name).mkdir()
        write(tmp_path / name, random_images(2))
    text, binary = (read_cameras(tmp_path / name) for name in ("text", "binary"))
    for first, second in zip(text, binary, strict=True):
        assert first.name == second.name and first.lens == second.lens
        assert (first.rotation == second.rotation).all() and (first.translation == second.translation).all()


def write_json(folder, _images):
    write_transforms(folder / "transforms.json", [random_pose(np.random.default_rng(9))], {"w": 640, "h": 480, "fl_x": 500.0, "k1": 0.1})


def write_xml(folder, _images):
    write_metashape(folder / "cameras.xml", [random_pose(np.random.default_rng(9))], (np.eye(3), np.zeros(3), 1.0), "<k1>0.1</k1>")


@pytest.mark.parametrize("write", [write_text, write_binary, write_json, write_xml])
@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_damaged_files_are_one_sentence_or_cameras(tmp_path_factory, write, seed):
    folder = tmp_path_factory.mktemp("damaged")
    write(folder, random_images(3))
    random = Random(seed)
    path = random.choice(sorted(folder.iterdir()))
    path.write_bytes(damage(random, path.read_bytes()))
    try:
        assert read_cameras(path if path.suffix == ".xml" else folder)
    except FarfieldError as error:
        assert "\n" not in str(error)


def random_pose(random):
    """Rotation world to camera (3, 3), with z forward, and center (3,)."""
    rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return rotation * np.sign(np.linalg.det(rotation)), random.normal(size=3)


def assert_projects(camera, rotation, center, project):
    """A camera projects points like the formula `project` of tangents u and v."""
    points = center + (np.random.default_rng(5).uniform(-0.4, 0.4, (40, 3)) + [0.0, 0.0, 2.0]) @ rotation
    local = (points - center) @ rotation.T
    x, y = project(*(local[:, :2] / local[:, 2:]).T)
    found, depths, is_valid = camera.project(points)
    assert is_valid.all() and depths == pytest.approx(local[:, 2])
    assert np.abs(found - np.stack([x, camera.lens.size[1] - y], axis=1)).max() < 1e-6


def write_transforms(path, poses, lens):
    frames = []
    for index, (rotation, center) in enumerate(poses):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation.T @ np.diag([1.0, -1.0, -1.0]), center  # y up, looks along -z
        frames.append({"file_path": f"./images/ü {index}.jpg", "transform_matrix": matrix.tolist()})
    path.write_text(json.dumps({**lens, "frames": frames}), encoding="utf-8")


@pytest.mark.parametrize("kind", ["angle", "opencv", "fisheye"])
def test_transforms_json(tmp_path, kind):
    random = np.random.default_rng(6)
    poses = [random_pose(random) for _ in range(3)]
    angle = {"w": 640, "h": 480, "camera_angle_x": 2 * np.arctan(320 / 500.0)}
    opencv = {"w": 640, "h": 480, "fl_x": 500.0, "fl_y": 505.0, "cx": 322.0, "cy": 238.0, "k1": 0.1, "k2": -0.02, "p1": 0.003, "p2": -0.001}
    lens = {"angle": angle, "opencv": opencv, "fisheye": opencv | {"camera_model": "OPENCV_FISHEYE", "k3": 0.01, "k4": 0.002}}[kind]
    write_transforms(tmp_path / "transforms.json", poses, lens)

    def project(u, v):
        square = u * u + v * v
        if kind == "angle":
            return 500.0 * u + 320.0, 500.0 * v + 240.0
        if kind == "opencv":
            radial = 1 + 0.1 * square - 0.02 * square**2
            x, y = u * radial + 0.006 * u * v - 0.001 * (square + 2 * u * u), v * radial - 0.002 * u * v + 0.003 * (square + 2 * v * v)
        else:
            radius = np.sqrt(square)
            theta = np.arctan(radius)
            x, y = np.array([u, v]) * (theta + 0.1 * theta**3 - 0.02 * theta**5 + 0.01 * theta**7 + 0.002 * theta**9) / radius
        return 500.0 * x + 322.0, 505.0 * y + 238.0

    for index, (camera, pose) in enumerate(zip(read_cameras(tmp_path), poses, strict=True)):
        assert camera.name == f"images/ü {index}.jpg"
        assert_projects(camera, *pose, project)


def write_metashape(path, poses, chunk, coefficients=""):
    rotation, translation, scale = chunk
    lines = ['<document version="1.5.0"><chunk><sensors><sensor id="0" type="frame"><calibration type="frame" class="adjusted">']
    lines += ['<resolution width="640" height="480"/><f>500</f><cx>3.5</cx><cy>-2</cy><b1>4</b1>', coefficients]
    lines += ["</calibration></sensor></sensors><cameras>", '<camera id="9" sensor_id="0" label="not aligned.jpg"/>']
    for index, (world_rotation, center) in enumerate(poses):
        pose = np.eye(4)
        pose[:3, :3] = rotation.T @ world_rotation.T
        pose[:3, 3] = rotation.T @ (center - translation) / scale
        numbers = " ".join(repr(float(value)) for value in pose.ravel())
        lines.append(f'<camera id="{index}" sensor_id="0" label="é {index}.jpg"><transform>{numbers}</transform></camera>')
    text = [" ".join(repr(float(value)) for value in np.ravel(part)) for part in (rotation, translation, scale)]
    lines.append(
        f"</cameras><transform><rotation>{text[0]}</rotation><translation>{text[1]}</translation><scale>{text[2]}</scale></transform>"
    )
    path.write_text("\n".join([*lines, "</chunk></document>"]), encoding="utf-8")


def test_metashape(tmp_path):
    random = np.random.default_rng(7)
    poses, chunk = [random_pose(random) for _ in range(3)], (random_pose(random)[0], np.array([5.0, -2.0, 1.0]), 2.5)
    coefficients = "<k1>0.1</k1><k2>-0.02</k2><k3>0.005</k3><p1>0.003</p1><p2>-0.001</p2>"
    write_metashape(tmp_path / "cameras.xml", poses, chunk, coefficients)

    def project(u, v):
        square = u * u + v * v
        radial = 1 + 0.1 * square - 0.02 * square**2 + 0.005 * square**3
        x = u * radial + 0.003 * (square + 2 * u * u) - 0.002 * u * v
        y = v * radial - 0.001 * (square + 2 * v * v) + 0.006 * u * v
        return 320.0 + 3.5 + 504.0 * x, 240.0 - 2.0 + 500.0 * y

    cameras = read_cameras(tmp_path / "cameras.xml")
    assert [camera.name for camera in cameras] == ["é 0.jpg", "é 1.jpg", "é 2.jpg"]
    for camera, pose in zip(cameras, poses, strict=True):
        assert_projects(camera, *pose, project)


def test_what_no_lens_has_is_refused(tmp_path):
    poses, chunk = [random_pose(np.random.default_rng(8))], (np.eye(3), np.zeros(3), 1.0)
    write_metashape(tmp_path / "cameras.xml", poses, chunk, "<p3>0.5</p3>")
    with pytest.raises(FileError, match="its lens has coefficients"):
        read_cameras(tmp_path / "cameras.xml")
    (tmp_path / "cameras.xml").write_text('<!DOCTYPE a [<!ENTITY b "c">]><document/>', encoding="utf-8")
    with pytest.raises(FileError, match="damaged or incomplete"):
        read_cameras(tmp_path / "cameras.xml")
    lens = {"w": 640, "h": 480, "fl_x": 500.0}
    for change, words in (({"w": None}, "damaged"), ({"fl_x": "wide"}, "damaged"), ({"k4": 0.1}, "coefficient k4")):
        write_transforms(tmp_path / "transforms.json", poses, lens | change)
        with pytest.raises(FileError, match=words):
            read_cameras(tmp_path / "transforms.json")
    for name, words in (("w", "size of the photograph .* is not known"), ("fl_x", "no focal length")):
        write_transforms(tmp_path / "transforms.json", poses, {key: value for key, value in lens.items() if key != name})
        with pytest.raises(FileError, match=words):
            read_cameras(tmp_path / "transforms.json")
    write_transforms(tmp_path / "transforms.json", [(np.diag([-1.0, 1.0, 1.0]), np.zeros(3))], lens)
    with pytest.raises(FileError, match="mirrored"):
        read_cameras(tmp_path / "transforms.json")


def test_missing_cameras_are_one_sentence(tmp_path):
    with pytest.raises(FileError, match="There are no cameras in"):
        read_cameras(tmp_path)
    write_text(tmp_path, [])
    with pytest.raises(FileError, match="no registered camera"):
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
