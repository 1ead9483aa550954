"""Photographs and masks are found by the names in camera files, and turned where a program has applied their orientation."""

import numpy as np
import pytest

from farfield.addon.bridge.photos.photo_files import check_mask_folder, read_photograph
from farfield.addon.bridge.photos.photo_folders import PhotoFolder
from farfield.addon.core.errors import FileError, ImageError
from image_data import write_image
from photo_scenes import camera_at


def touch(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")


@pytest.mark.parametrize(
    ("name", "files", "found"),
    [
        ("a.png", ["a.png", "a.jpg", "A.png"], "a.png"),
        ("DSC_0000", ["DSC_0000.JPG"], "DSC_0000.JPG"),
        ("dsc_0000.jpg", ["DSC_0000.JPG"], "DSC_0000.JPG"),
        ("DSC_0000.jpg", ["DSC_0000.TIF"], "DSC_0000.TIF"),
        ("DSC_0000.NEF", ["DSC_0000.jpg"], "DSC_0000.jpg"),
        ("frame.0000", ["frame.0000.png", "frame.png"], "frame.0000.png"),
        ("frame.0000", ["frame.png"], None),
        ("frame.0000.png", ["frame.0000.jpg", "frame.0000.png.jpg"], "frame.0000.png.jpg"),
        ("scan.final.png", ["scan.png"], None),
        ("left/1.png", ["1.png", "left/1.png"], "left/1.png"),
        ("left/1.png", ["1.png", "left/1.JPG"], "left/1.JPG"),
        ("images\\left\\1.png", ["left/1.png"], "left/1.png"),
        ("C:\\Users\\x\\images\\1.png", ["1.png"], "1.png"),
        ("C:1.png", ["1.png"], None),
        ("/scans/x/images/left/1.png", ["left/1.png", "1.png"], "left/1.png"),
        ("./../rgb/1.png", ["rgb/1.png"], "rgb/1.png"),
        ("e\u0301t\u00e9.png", ["\u00e9te\u0301.png"], "\u00e9te\u0301.png"),
        ("a b.png", ["a b.png"], "a b.png"),
        ("a" * 300, ["a.png"], None),
        ("a/" * 3000 + "b.png", ["b.png"], "b.png"),
        ("a\0b.png", ["b.png"], None),
        ("..", ["b.png"], None),
        ("", ["b.png"], None),
        ("/", ["b.png"], None),
    ],
)
def test_photographs_are_found_by_their_names(tmp_path, name, files, found):
    touch(tmp_path, *files)
    if found is None:
        with pytest.raises(FileError, match="There is no photograph"):
            PhotoFolder(tmp_path).find_photograph(name)
    else:
        assert PhotoFolder(tmp_path).find_photograph(name) == tmp_path / found


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("1.jpg", "1.jpg.png"),
        ("1.jpg", "1.png"),
        ("1.jpg", "1_mask.png"),
        ("1.JPG", "1.jpg.PNG"),
        ("DSC_0000", "DSC_0000.png"),
        ("DSC_0000", "DSC_0000.JPG.png"),
        ("frame.0000", "frame.0000.png"),
        ("left\\1.jpg", "left/1.png"),
        ("D:\\a\\1.jpg", "1.png"),
    ],
)
def test_masks_are_found_by_the_same_names(tmp_path, name, file):
    touch(tmp_path, file)
    assert PhotoFolder(tmp_path).find_mask(name) == tmp_path / file
    assert check_mask_folder(PhotoFolder(tmp_path), [name, "other.png"]) == ["other.png"]
    for other in ("2.jpg", "a" * 300, "frame.0001"):
        assert PhotoFolder(tmp_path).find_mask(other) is None


def test_two_names_of_one_file_are_refused(tmp_path):
    touch(tmp_path, "1.png")
    folder = PhotoFolder(tmp_path)
    assert folder.find_photograph("left/1.png") == folder.find_photograph("left/1.png") == tmp_path / "1.png"
    with pytest.raises(FileError, match=r'"left/1\.png" and "right/1\.png" are both'):
        folder.find_photograph("right/1.png")


def upright(stored, orientation):
    """What a viewer shows of pixels with an orientation: where the first row and the first column of `stored` are."""
    height, width = stored.shape[:2]
    result = np.empty((width, height, *stored.shape[2:]), stored.dtype)
    for row in range(height):
        for column in range(width):
            x, y = {5: (row, column), 6: (-1 - row, column), 7: (-1 - row, -1 - column), 8: (row, -1 - column)}[orientation]
            result[y, x] = stored[row, column]
    return result


@pytest.mark.parametrize("orientation", [5, 6, 7, 8])
def test_orientation_is_applied_where_the_sizes_say_so(tmp_path, orientation):
    """Programs use pixels as stored, so a camera of that size does. Cameras and masks with width and height exchanged are upright."""
    random = np.random.default_rng(orientation)
    stored, mask = random.integers(0, 256, (6, 9, 3), np.uint8), random.integers(0, 2, (6, 9, 1), np.uint8) * np.uint8(255)
    for name in ("images", "masks"):
        (tmp_path / name).mkdir()
    write_image(tmp_path / "images" / "a.tif", stored, {"Orientation": orientation})
    images, masks = PhotoFolder(tmp_path / "images"), PhotoFolder(tmp_path / "masks")
    turned, turned_mask = upright(stored, orientation), upright(mask, orientation)
    for size, expected, expected_mask in (((9, 6), stored, mask), ((6, 9), turned, turned_mask)):
        camera = camera_at((0.0, 0.0, 3.0), size=size, focal=9.0, name="a.tif")
        for given in (mask, turned_mask):
            write_image(tmp_path / "masks" / "a.png", given)
            found = read_photograph(camera, images, masks)
            assert np.array_equal(found.pixels[::-1], expected)
            assert np.array_equal(found.mask[::-1], expected_mask[..., 0] > 0)
    with pytest.raises(ImageError, match="has 9 x 6 pixels, but its camera 6 x 8"):
        read_photograph(camera_at((0.0, 0.0, 3.0), size=(6, 8), focal=9.0, name="a.tif"), images)


@pytest.mark.parametrize("orientation", [1, 2, 3, 4])
def test_orientations_that_keep_the_size_are_not_applied(tmp_path, orientation):
    stored = np.random.default_rng(0).integers(0, 256, (6, 9, 3), np.uint8)
    write_image(tmp_path / "a.tif", stored, {"Orientation": orientation})
    camera = camera_at((0.0, 0.0, 3.0), size=(9, 6), focal=9.0, name="a.tif")
    assert np.array_equal(read_photograph(camera, PhotoFolder(tmp_path)).pixels[::-1], stored)
    with pytest.raises(ImageError, match="has 9 x 6 pixels, but its camera 6 x 9"):
        read_photograph(camera_at((0.0, 0.0, 3.0), size=(6, 9), focal=9.0, name="a.tif"), PhotoFolder(tmp_path))
