"""Camera files as their programs and people write them: variants of a format give the same cameras, and what cannot be used is named."""

import json

import numpy as np
import pytest

from camera_files import CAMERAS, FLIP, SIZE, assert_same, numbers, poses, quaternion
from farfield.addon.core.errors import FileError
from farfield.addon.core.photos.importers import read_camera_file, read_cameras


class TestColmap:
    """Text files, as COLMAP reads them."""

    def write(self, folder, after_header=(), second=("",), lens=f"1 SIMPLE_PINHOLE {SIZE[0]} {SIZE[1]} 300 150 120"):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "cameras.txt").write_text(f"  # a comment\n{lens}\n", encoding="utf-8")
        lines = ["# a comment", *after_header]
        for index, camera in enumerate(CAMERAS, start=1):
            lines += [f"{index} {numbers((*quaternion(camera.rotation), *camera.translation))} 1 {camera.name}", *second]
        (folder / "images.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")

    @pytest.mark.parametrize(
        "variant",
        [
            {},
            {"after_header": [""]},
            {"after_header": ["", "  # another"]},
            {"second": ["", ""]},
            {"second": ["", "", "# between", ""]},
            {"second": []},
            {"second": ["10.5 20.5 -1 30 40 5"]},
            {"second": ["10.5 20.5 -1 30 40 5", ""]},
            {"after_header": [""], "second": ["1 2 3 4 5 6 7 8 9 10 11 12"]},
            {"second": ["TODO"]},
            {"second": ["\t"]},
            {"lens": "1 SIMPLE_PINHOLE 300.0 240.0 300 150 120"},
            {"lens": "1.0 SIMPLE_PINHOLE 300 240 300 150 120"},
        ],
    )
    def test_variants_of_text_files_are_the_same_cameras(self, tmp_path, variant):
        self.write(tmp_path, **variant)
        assert_same(read_cameras(tmp_path))

    def test_the_largest_of_several_models_is_read(self, tmp_path):
        self.write(tmp_path / "sparse" / "1", second=["10.5 20.5 -1 30 40 5"])
        self.write(tmp_path / "sparse" / "0")
        found = read_camera_file(tmp_path)
        assert_same(found.cameras)
        assert found.notes == ["Only the largest model of COLMAP was read, sparse/1, not 0."]

    def test_files_of_text_count_where_binary_ones_are_not_complete(self, tmp_path):
        self.write(tmp_path)
        (tmp_path / "images.bin").write_bytes(bytes(8))
        assert_same(read_cameras(tmp_path))

    def test_cameras_with_unknown_lenses_are_skipped(self, tmp_path):
        self.write(tmp_path, lens="1 SIMPLE_PINHOLE 300 240 300 150 120\n2 ORTHOPHOTO 300 240 300 150 120")
        path = tmp_path / "images.txt"
        path.write_text(path.read_text(encoding="utf-8").replace(" 1 2.png", " 2 2.png"), encoding="utf-8")
        found = read_camera_file(tmp_path)
        assert_same(found.cameras, ("0.png", "1.png", "3.png"))
        assert found.notes == ['Skipped: "2.png" (its lens model is ORTHOPHOTO).']


class TestTransforms:
    """`transforms.json` of NeRF programs, and other JSON files."""

    LENS = {"w": 300, "h": 240, "fl_x": 300.0}

    def write(self, path, lens=None, **changes):
        frames = [
            {"file_path": f"./images/{index}.png", "transform_matrix": (pose @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist()}
            for index, pose in enumerate(poses())
        ]
        path.write_text(json.dumps((self.LENS if lens is None else lens) | {"frames": frames} | changes), encoding="utf-8")
        return path

    @pytest.mark.parametrize(
        "lens",
        [
            {"camera_angle_x": 2.0 * np.arctan(0.5)},
            {"camera_angle_y": 2.0 * np.arctan(120.0 / 300.0)},
            {"fl_y": 300.0},
            {"w": 300.0, "h": 240.0, "fl_x": 300, "camera_model": "SIMPLE_PINHOLE"},
            {"w": 300, "h": 240, "fl_x": 300, "camera_model": "FULL_OPENCV", "k6": 0.0},
        ],
    )
    def test_sizes_and_focal_lengths_are_completed(self, tmp_path, lens):
        assert_same(read_cameras(self.write(tmp_path / "transforms.json", lens), lambda _: SIZE))
        assert_same(read_cameras(self.write(tmp_path / "transforms_train.json", lens).parent, lambda _: SIZE))

    @pytest.mark.parametrize("model", ["EQUIRECTANGULAR", "ORTHOPHOTO", "FISHEYE624", "RATIONAL"])
    def test_other_projections_are_refused_by_name(self, tmp_path, model):
        with pytest.raises(FileError, match=f"its camera model is {model}"):
            read_cameras(self.write(tmp_path / "transforms.json", camera_model=model))
        path = self.write(tmp_path / "transforms.json")
        document = json.loads(path.read_text(encoding="utf-8"))
        document["frames"][1]["camera_model"] = model
        path.write_text(json.dumps(document), encoding="utf-8")
        found = read_camera_file(path)
        assert_same(found.cameras, ("0.png", "2.png", "3.png"))
        assert found.notes == [f'Skipped: "./images/1.png" (its camera model is {model}).']

    def test_the_transform_of_nerfstudio_is_undone(self, tmp_path):
        """The file has the cameras of another program after x, z, -y; its meshes are where they were before."""
        path = self.write(tmp_path / "transforms.json")
        document = json.loads(path.read_text(encoding="utf-8"))
        applied = np.array([[1.0, 0.0, 0.0, 0.5], [0.0, 0.0, 1.0, -2.0], [0.0, -1.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]])
        for frame in document["frames"]:
            matrix = applied @ np.array(frame["transform_matrix"])
            matrix[:3, 3] *= 0.25
            frame["transform_matrix"] = matrix.tolist()
        document |= {"applied_transform": applied[:3].tolist(), "applied_scale": 0.25}
        path.write_text(json.dumps(document), encoding="utf-8")
        found = read_camera_file(path)
        assert_same(found.cameras)
        assert found.notes == ["The cameras are where they were before the applied_transform of nerfstudio."]

    def test_masks_of_the_file_are_named(self, tmp_path):
        path = self.write(tmp_path / "transforms.json")
        path.write_text(path.read_text(encoding="utf-8").replace('"file_path"', '"mask_path": "m.png", "file_path"'), encoding="utf-8")
        assert "masks that the camera file names" in read_camera_file(path).notes[0]

    def test_transposed_matrices_are_refused(self, tmp_path):
        path = self.write(tmp_path / "transforms.json")
        document = json.loads(path.read_text(encoding="utf-8"))
        for frame in document["frames"]:
            frame["transform_matrix"] = np.array(frame["transform_matrix"]).T.tolist()
        path.write_text(json.dumps(document), encoding="utf-8")
        with pytest.raises(FileError, match="last row is not 0, 0, 0, 1"):
            read_cameras(path)

    @pytest.mark.parametrize(
        ("document", "words"),
        [
            ([{"cameras": {}, "shots": {}, "points": {}}], "OpenSfM"),
            ([{"id": 0, "img_name": "a", "width": 1, "rotation": [], "position": []}], "Gaussian Splatting"),
            ([{"file_path": "a.png", "transform": []}], "nerfstudio"),
            ({"sfm_data_version": "0.3", "views": []}, "OpenMVG"),
            ({"camera_path": [], "keyframes": []}, "camera path of nerfstudio"),
            ({"transform": [], "scale": 1.0}, "scene of nerfstudio"),
            ({"class_name": "PinholeCameraTrajectory", "version_major": 1}, "Open3D"),
            ({"t_00": 1, "t_03": 0, "fx": 1}, "Polycam"),
            ({"views": [], "intrinsics": []}, "StructureFromMotion"),
            ({}, "neither frames"),
            ([], "neither frames"),
            (5, "neither frames"),
        ],
    )
    def test_files_of_other_programs_are_named(self, tmp_path, document, words):
        (tmp_path / "a.json").write_text(json.dumps(document), encoding="utf-8")
        with pytest.raises(FileError, match=words):
            read_cameras(tmp_path / "a.json")


class TestBundlerAndVisualSfm:
    """Headers, lists of photographs, and fixed lenses."""

    def write_bundler(self, folder, header="# Bundle file v0.3\n# by another program\n", listed="list.txt", name="bundle.out"):
        lines = [f"{len(CAMERAS)} 0"]
        for camera in CAMERAS:
            lines += ["300 0 0", *(numbers(row) for row in FLIP @ camera.rotation), numbers(FLIP @ camera.translation)]
        (folder / "model").mkdir(exist_ok=True)
        (folder / "model" / name).write_text(header + "\n".join(lines) + "\n", encoding="utf-8")
        names = "".join(f"C:\\photos\\{camera.name}\n" for camera in CAMERAS)
        (folder / "model" / listed).write_text(names, encoding="utf-8")
        return folder / "model" / name

    @pytest.mark.parametrize(
        ("listed", "name"),
        [
            ("list.txt", "bundle.out"),
            ("../list.txt", "bundle.out"),
            ("a.list.txt", "a.bundle.out"),
            ("bundler_list.txt", "bundler.out"),
            ("imagelist.lst", "bundler.out"),
            ("bundler.lst", "bundler.out"),
        ],
    )
    def test_the_list_of_photographs_is_found(self, tmp_path, listed, name):
        found = read_cameras(self.write_bundler(tmp_path, listed=listed, name=name), lambda _: SIZE)
        assert_same(found)
        assert found[0].name == "C:/photos/0.png"

    def test_headers(self, tmp_path):
        assert_same(read_cameras(self.write_bundler(tmp_path, header=""), lambda _: SIZE))
        for header, words in (("# Bundle file v0.4\n", "has version 0.4"), ("drews 1.0\n", "MVE")):
            with pytest.raises(FileError, match=words):
                read_cameras(self.write_bundler(tmp_path, header=header), lambda _: SIZE)

    @pytest.mark.parametrize(("header", "distortion"), [("NVM_V3 FixedK 310 140 320 130 0.1", 0.1), ("NVM_V3 FixedK 310 140 320 130", 0.0)])
    def test_a_fixed_lens_of_visualsfm_is_used(self, tmp_path, header, distortion):
        """fx, cx, fy, cy, and the distortion, which leads from measured to undistorted positions."""
        lines = [f"{each.name}\t300 {numbers((*quaternion(each.rotation), *each.position))} 0 0" for each in CAMERAS]
        path = tmp_path / "a.nvm"
        path.write_text("\n".join([header, "", str(len(lines)), *lines]), encoding="utf-8")
        measured = np.random.default_rng(2).uniform(-0.3, 0.3, (20, 2))
        straight = measured * (1.0 + distortion * (measured**2).sum(axis=1, keepdims=True))
        for camera in read_cameras(path, lambda _: SIZE):
            found = camera.lens.project(np.column_stack([straight, np.ones(20)]))[0]
            assert found == pytest.approx(np.stack([140 + 310 * measured[:, 0], 240 - 130 - 320 * measured[:, 1]], axis=1))

    def test_other_headers_of_visualsfm_are_refused(self, tmp_path):
        (tmp_path / "a.nvm").write_text("NVM_V3_R9T\n\n0\n", encoding="utf-8")
        with pytest.raises(FileError, match="begins with"):
            read_cameras(tmp_path / "a.nvm", lambda _: SIZE)


@pytest.mark.parametrize(
    ("intrinsic", "reason"),
    [
        ({"type": "equidistant", "distortionType": "none"}, "equidistant"),
        ({"type": "pinhole", "distortionType": "none", "undistortionType": "3deanamorphic4"}, "3deanamorphic4"),
        ({"type": "pinhole", "distortionType": "3declassicld"}, "3declassicld"),
    ],
)
def test_views_of_meshroom_with_other_lenses_are_skipped(tmp_path, intrinsic, reason):
    shared = {"width": "300", "height": "240", "focalLength": "30", "sensorWidth": "30", "principalPoint": ["0", "0"]}
    document = {
        "version": ["1", "2", "6"],
        "intrinsics": [
            shared | {"intrinsicId": "1", "type": "pinhole", "distortionType": "none"},
            shared | {"intrinsicId": "2"} | intrinsic,
        ],
        "poses": [
            {"poseId": str(index), "pose": {"transform": {"rotation": pose[:3, :3].ravel().tolist(), "center": pose[:3, 3].tolist()}}}
            for index, pose in enumerate(poses())
        ],
        "views": [
            {"viewId": str(index), "poseId": str(index), "intrinsicId": "2" if index == 1 else "1", "path": f"D:\\scan\\{index}.png"}
            for index in range(4)
        ],
    }
    for name in ("cameras.sfm", "cameras.json"):
        (tmp_path / name).write_text(json.dumps(document), encoding="utf-8")
        found = read_camera_file(tmp_path / name)
        assert_same(found.cameras, ("0.png", "2.png", "3.png"))
        assert found.notes == [f'Skipped: "D:\\scan\\1.png" (its lens is of the type "{reason}").']


def test_photographs_of_the_same_name_are_skipped(tmp_path):
    """Nobody knows which one belongs to which camera; equal cameras are one."""
    TestTransforms().write(tmp_path / "transforms.json")
    document = json.loads((tmp_path / "transforms.json").read_text(encoding="utf-8"))
    document["frames"].append(document["frames"][0])
    document["frames"][2]["file_path"] = "./images/1.png"
    (tmp_path / "transforms.json").write_text(json.dumps(document), encoding="utf-8")
    found = read_camera_file(tmp_path / "transforms.json")
    assert_same(found.cameras, ("0.png", "3.png"))
    assert found.notes == ['Skipped: "images/1.png" (several cameras have this name).']


VALUES = (0, -1, 1e300, 1e-300, float("nan"), float("inf"), "x", [], {}, 10**40, 1e12, 3.14159265)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("key", ["w", "h", "fl_x", "fl_y", "camera_angle_x", "cx", "k1", "k4", "p1", "applied_scale", "applied_transform"])
def test_impossible_numbers_are_one_sentence(tmp_path, key):
    for model in ("OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV"):
        for value in VALUES:
            lens = TestTransforms.LENS | {"camera_model": model, key: value}
            if key == "camera_angle_x":
                del lens["fl_x"]
            TestTransforms().write(tmp_path / "transforms.json", lens)
            try:
                cameras = read_cameras(tmp_path / "transforms.json")
            except FileError as error:
                assert "\n" not in str(error)
            else:
                assert all(np.isfinite(camera.position).all() for camera in cameras)


@pytest.mark.parametrize("name", ["/", "", ".", "..", "\\", "C:", " ", "a\0.png", "\ud800.png"])
def test_names_of_nothing_are_one_sentence(tmp_path, name):
    path = TestTransforms().write(tmp_path / "transforms.json")
    path.write_text(path.read_text(encoding="utf-8").replace("./images/1.png", json.dumps(name)[1:-1]), encoding="utf-8")
    with pytest.raises(FileError, match="damaged or incomplete"):
        read_cameras(path)


def test_long_paths_are_one_sentence(tmp_path):
    for name in ("a" * 300, "a" * 300 + ".json", "b/" * 3000):
        with pytest.raises(FileError, match="Cannot read"):
            read_cameras(tmp_path / name)
