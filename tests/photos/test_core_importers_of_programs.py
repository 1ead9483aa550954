"""Cameras of Meshroom, Bundler, VisualSFM and OpenMVS: files written by the formulas of the program project like them."""

import json
import struct
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import FarfieldError, FileError
from farfield.addon.core.photos.importers import read_cameras
from random_inputs import damage

SIZE = (640, 480)
FOCAL = 500.0
NAMES = ("é 0.jpg", "b/1.png", "2.tif")
FLIP = np.diag([1.0, -1.0, -1.0])


def random_poses(seed=0):
    """Rotation world to camera (3, 3), with z forward and y down, and center (3,) of each photograph."""
    random = np.random.default_rng(seed)
    poses = []
    for _ in NAMES:
        rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
        poses.append((rotation * np.sign(np.linalg.det(rotation)), random.normal(size=3)))
    return poses


def scale_by(u, v, *coefficients):
    square = u * u + v * v
    factor = 1 + sum(coefficient * square**power for power, coefficient in enumerate(coefficients, start=1))
    return u * factor, v * factor


def assert_projects(path, project, names=NAMES):
    """The cameras in a file project points like `project` of tangents, in pixels from the upper left corner of the image."""
    cameras = {camera.name: camera for camera in read_cameras(path, lambda _: SIZE)}
    assert set(cameras) == set(names)
    for name, (rotation, center) in zip(NAMES, random_poses(), strict=True):
        if name in names:
            local = np.random.default_rng(5).uniform(-0.4, 0.4, (40, 3)) + [0.0, 0.0, 2.0]
            found, depths, is_valid = cameras[name].project(local @ rotation + center)
            x, y = project(*(local[:, :2] / local[:, 2:]).T)
            assert is_valid.all() and depths == pytest.approx(local[:, 2])
            assert np.abs(found - np.stack([x, SIZE[1] - y], axis=1)).max() < 1e-3


def write_meshroom(path, lens=None, version=("1", "2", "6")):
    lens = lens or {"focalLength": "25", "sensorWidth": "32", "principalPoint": ["3", "-2"], "distortionType": "radialk3",
                    "distortionParams": ["0.1", "-0.02", "0.005"], "type": "pinhole"}  # fmt: skip
    poses = [
        {"poseId": str(10 + index), "pose": {"transform": {"rotation": [repr(float(value)) for value in rotation.T.ravel()],
                                                           "center": [repr(float(value)) for value in center]}}}
        for index, (rotation, center) in enumerate(random_poses())
    ]  # fmt: skip
    views = [{"viewId": str(index), "poseId": str(10 + index), "intrinsicId": "7", "path": name} for index, name in enumerate(NAMES)]
    views.append({"viewId": "9", "poseId": "99", "intrinsicId": "7", "path": "not registered.jpg"})
    intrinsic = {"intrinsicId": "7", "width": str(SIZE[0]), "height": str(SIZE[1])} | lens
    document = {"version": list(version), "views": views, "intrinsics": [intrinsic], "poses": poses}
    path.write_text(json.dumps(document), encoding="utf-8")


def test_meshroom(tmp_path):
    path = tmp_path / "cameras.sfm"
    write_meshroom(path)

    def project(u, v):
        x, y = scale_by(u, v, 0.1, -0.02, 0.005)
        return FOCAL * x + 323.0, FOCAL * y + 238.0

    assert_projects(path, project)
    write_meshroom(path, {"pxFocalLength": "500", "principalPoint": ["323", "238"], "type": "radial3",
                          "distortionParams": ["0.1", "-0.02", "0.005"]}, ("1", "0", "0"))  # fmt: skip
    assert_projects(path, project)


@pytest.mark.parametrize("kind", ["none", "radialk1", "brown", "fisheye4", "fisheye1"])
def test_lenses_of_meshroom(tmp_path, kind):
    parameters = {"none": (), "radialk1": (0.1,), "brown": (0.1, -0.02, 0.005, 0.003, -0.001), "fisheye4": (0.1, -0.02, 0.01, 0.002),
                  "fisheye1": (0.9,)}[kind]  # fmt: skip
    lens = {"focalLength": "25", "sensorWidth": "32", "principalPoint": ["0", "0"], "type": "pinhole", "distortionType": kind}
    write_meshroom(tmp_path / "cameras.sfm", lens | {"distortionParams": [str(value) for value in parameters]})

    def project(u, v):
        radius = np.hypot(u, v)
        square = radius**2
        x, y = scale_by(u, v, *parameters[:3]) if kind in ("none", "radialk1", "brown") else (u, v)
        if kind == "brown":
            t1, t2 = parameters[3:]
            x, y = x + t2 * (square + 2 * u * u) + 2 * t1 * u * v, y + t1 * (square + 2 * v * v) + 2 * t2 * u * v
        elif kind == "fisheye4":
            x, y = scale_by(u * np.arctan(radius) / radius, v * np.arctan(radius) / radius, *parameters)
        elif kind == "fisheye1":
            factor = np.arctan(2 * radius * np.tan(0.5 * parameters[0])) / (radius * parameters[0])
            x, y = u * factor, v * factor
        return FOCAL * x + 320.0, FOCAL * y + 240.0

    assert_projects(tmp_path / "cameras.sfm", project)


def write_bundler(path, names=NAMES):
    lines = ["# Bundle file v0.3", f"{len(NAMES)} 0"]
    for name, (rotation, center) in zip(NAMES, random_poses(), strict=True):
        upward = FLIP @ rotation  # y up, looks along -z
        lines += [f"{FOCAL} 0.1 -0.02" if name in names else "0 0 0"]
        lines += [" ".join(repr(float(value)) for value in row) for row in [*upward, -upward @ center]]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    (path.parent / "list.txt").write_text("".join(f"{name} 0 {FOCAL}\n" for name in NAMES), encoding="utf-8")


def test_bundler_leaves_out_what_is_not_registered(tmp_path):
    write_bundler(tmp_path / "bundle.out", NAMES[1:])

    def project(u, v):
        x, y = scale_by(u, v, 0.1, -0.02)
        return FOCAL * x + 320.0, FOCAL * y + 240.0

    assert_projects(tmp_path / "bundle.out", project, NAMES[1:])


def quaternion(rotation):
    """(w, x, y, z) of a rotation, by the eigenvector of the largest eigenvalue."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    matrix = np.array([[a + e + i, h - f, c - g, d - b], [h - f, a - e - i, b + d, c + g], [c - g, b + d, e - a - i, f + h],
                       [d - b, c + g, f + h, i - a - e]])  # fmt: skip
    return np.linalg.eigh(matrix)[1][:, -1]


def write_nvm(path):
    lines = ["NVM_V3 ", "", str(len(NAMES))]
    for name, (rotation, center) in zip(NAMES, random_poses(), strict=True):
        numbers = [FOCAL, *quaternion(rotation), *center, -0.15]
        lines.append(name.replace(" ", '"') + "\t" + " ".join(repr(float(value)) for value in numbers) + " 0")
    path.write_text("\n".join([*lines, "", "0", ""]), encoding="utf-8")


def test_visualsfm(tmp_path):
    """Its distortion d leads from the measured position to the tangent: d (1 - 0.15 d^2) = r."""
    write_nvm(tmp_path / "model.nvm")

    def project(u, v):
        radius = np.hypot(u, v)
        distorted = np.array([min(root.real for root in np.roots([-0.15, 0.0, 1.0, -each]) if root.real > 0.0) for each in radius])
        return FOCAL * u * distorted / radius + 320.0, FOCAL * v * distorted / radius + 240.0

    assert_projects(tmp_path / "model.nvm", project)


def counted(text):
    return struct.pack("<Q", len(text.encode())) + text.encode()


def write_openmvs(path, version=7, *, has_size=True):
    """One platform with a camera that is mounted askew, and a pose per photograph; the last image has no pose."""
    mount, offset = random_poses(3)[0]
    intrinsics = np.array([[FOCAL, 0.0, 322.5], [0.0, 510.0, 237.5], [0.0, 0.0, 1.0]]) / (1.0 if has_size else max(SIZE))
    data = b"MVSI" + struct.pack("<II", version, 0) + struct.pack("<Q", 1) + counted("platform") + struct.pack("<Q", 1) + counted("camera")
    data += counted("RGB") if version > 3 else b""
    data += struct.pack("<II", *(SIZE if has_size else (0, 0)))
    data += struct.pack("<21d", *intrinsics.ravel(), *mount.ravel(), *offset) + struct.pack("<Q", len(NAMES))
    for rotation, center in random_poses():
        platform = mount.T @ rotation
        data += struct.pack("<12d", *platform.ravel(), *(center - platform.T @ offset))
    data += struct.pack("<Q", len(NAMES) + 1)
    for index, name in enumerate([*NAMES, "not registered.jpg"]):
        data += counted(name.replace("/", "\\")) + (counted("mask.png") if version > 4 else b"")
        data += struct.pack("<III", 0, 0, index if index < len(NAMES) else 2**32 - 1)
        data += struct.pack("<I", index) if version > 2 else b""
        if version > 6:
            data += struct.pack("<3fQ", 1.0, 2.0, 3.0, 1) + struct.pack("<II4f", 1, 2, 1.0, 1.0, 1.0, 1.0)
    path.write_bytes(data + struct.pack("<5Q", 0, 0, 0, 0, 0))


@pytest.mark.parametrize("version", range(1, 8))
@pytest.mark.parametrize("has_size", [True, False])
def test_openmvs(tmp_path, version, has_size):
    write_openmvs(tmp_path / "scene.mvs", version, has_size=has_size)
    assert_projects(tmp_path / "scene.mvs", lambda u, v: (FOCAL * u + 323.0, 510.0 * v + 238.0))


WRITERS = {"cameras.sfm": write_meshroom, "bundle.out": write_bundler, "model.nvm": write_nvm, "scene.mvs": write_openmvs}


@pytest.mark.parametrize("name", WRITERS)
@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_damaged_files_are_one_sentence_or_cameras(tmp_path_factory, name, seed):
    folder = tmp_path_factory.mktemp("damaged")
    WRITERS[name](folder / name)
    random = Random(seed)
    path = random.choice(sorted(folder.iterdir()))
    path.write_bytes(damage(random, path.read_bytes()))
    try:
        assert read_cameras(folder / name, lambda _: SIZE)
    except FarfieldError as error:
        assert "\n" not in str(error)


def test_what_cannot_be_read_is_one_sentence(tmp_path):
    write_bundler(tmp_path / "bundle.out")
    with pytest.raises(FileError, match=r'The size of the photograph "é 0\.jpg" is not known'):
        read_cameras(tmp_path / "bundle.out")
    (tmp_path / "list.txt").unlink()
    with pytest.raises(FileError, match=r"no list\.txt next to"):
        read_cameras(tmp_path / "bundle.out", lambda _: SIZE)
    (tmp_path / "scene.mvs").write_bytes(b"MVS\0" + bytes(40))
    with pytest.raises(FileError, match=r"not an interface file of OpenMVS"):
        read_cameras(tmp_path / "scene.mvs", lambda _: SIZE)
    write_meshroom(tmp_path / "a.sfm", {"type": "pinhole", "distortionType": "3deanamorphic4", "principalPoint": ["0", "0"]})
    with pytest.raises(FileError, match=r"lens is of the type"):
        read_cameras(tmp_path / "a.sfm")
    write_nvm(tmp_path / "empty.nvm")
    (tmp_path / "empty.nvm").write_text("NVM_V3\n0\n", encoding="utf-8")
    with pytest.raises(FileError, match="no registered camera"):
        read_cameras(tmp_path / "empty.nvm", lambda _: SIZE)


def write_pairs(path, name="é 0.jpg", *, wrong=None):
    """Ten pairs of a camera with focal length 500, after a comment."""
    (rotation, center), random = random_poses()[0], np.random.default_rng(6)
    local = random.uniform(-0.4, 0.4, (10, 3)) + [0.0, 0.0, 1.0]
    positions = FOCAL * local[:, :2] / local[:, 2:] + [320.0, 240.0]
    if wrong is not None:
        positions[wrong] += [80.0, -50.0]
    numbers = np.concatenate([local @ rotation + center, positions], axis=1)
    lines = [" ".join(repr(float(value)) for value in row) + f"  {name}" for row in numbers]
    path.write_text("\n".join(["# x y z column row photograph", *lines, ""]), encoding="utf-8")


def test_pairs_of_points(tmp_path):
    write_pairs(tmp_path / "points.pairs")
    assert_projects(tmp_path / "points.pairs", lambda u, v: (FOCAL * u + 320.0, FOCAL * v + 240.0), NAMES[:1])


@pytest.mark.slow
def test_damaged_pairs_are_one_sentence(tmp_path):
    path = tmp_path / "points.pairs"
    write_pairs(path, wrong=3)
    with pytest.raises(FileError, match=r'Line 5 of .* does not fit to the other pairs of "é 0\.jpg": 9\d pixels away'):
        read_cameras(path, lambda _: SIZE)
    for text, words in (("# nothing\n", "no pair of points"), ("1 2 3 4 five a.jpg\n", "Line 1"), ("1 2 3 4 5\n", "Line 1")):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(FileError, match=words):
            read_cameras(path, lambda _: SIZE)
    path.write_text("1 2 3 4 5 a.jpg\n", encoding="utf-8")
    with pytest.raises(FarfieldError, match="has 1 of the 6 pairs of points that are needed"):
        read_cameras(path, lambda _: SIZE)
