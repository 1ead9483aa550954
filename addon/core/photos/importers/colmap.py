"""Cameras of COLMAP: the files `cameras` and `images` of a sparse model, as text or binary."""

from pathlib import Path

import numpy as np

from ...errors import FileError
from ...files.file_access import read_file
from ...geometry.lenses import MODELS, Lens, PhotoCamera
from .camera_notes import CameraNotes, UnusableCameraError
from .reading import BinaryReader, ReadSize, read_text_lines, rotation_of_quaternion

EXTENSIONS = (".bin", ".txt")
PARAMETER_COUNTS = {  # Lens models in the order of their numbers in binary files, also those that no model here equals.
    "SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8, "FULL_OPENCV": 12, "FOV": 5,
    "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5, "THIN_PRISM_FISHEYE": 12, "RAD_TAN_THIN_PRISM_FISHEYE": 16, "SIMPLE_DIVISION": 4,
    "DIVISION": 5, "SIMPLE_FISHEYE": 3, "FISHEYE": 4, "EUCM": 6, "EQUIRECTANGULAR": 2,
}  # fmt: skip
MODEL_NAMES = tuple(PARAMETER_COUNTS)
EQUIDISTANT = {
    "SIMPLE_FISHEYE": ("SIMPLE_RADIAL_FISHEYE", (0.0,)),
    "FISHEYE": ("OPENCV_FISHEYE", (0.0,) * 4),
}  # equal with these coefficients
POINT_BYTES = 24  # A 2D point of an image has two coordinates and an ID of 8 bytes each.
IMAGE_VALUES = 10  # ID, quaternion, translation, camera and name
RawLens = tuple[str, int, int, tuple[float, ...]]  # model, width, height and parameters
RawImage = tuple[str, int, tuple[float, ...], tuple[float, ...]]  # name, camera, quaternion and translation


def read_folder(folder: Path, _read_size: ReadSize, notes: CameraNotes) -> list[PhotoCamera]:
    """Read the cameras of all registered images in `folder`, in the order of their names; those with an unknown lens model are skipped.
    Raises FileError if a file is missing, cannot be read, or refers to something that does not exist."""
    complete = [each for each in EXTENSIONS if all((folder / f"{name}{each}").is_file() for name in ("cameras", "images"))]
    extension = complete[0] if complete else next(each for each in EXTENSIONS if (folder / f"images{each}").is_file())
    cameras_path, images_path = folder / f"cameras{extension}", folder / f"images{extension}"
    if extension == ".bin":
        lenses, poses = _read_binary_cameras(cameras_path), _read_binary_images(images_path)
    else:
        lenses, poses = _read_text_cameras(cameras_path), _read_text_images(images_path)
    cameras = []
    for name, lens_id, quaternion, translation in sorted(poses, key=lambda pose: pose[0]):
        if lens_id not in lenses:
            raise FileError(
                f'The image "{name}" in "{images_path}" has the camera {lens_id}, which does not exist; export both files again.'
            )
        with notes.skip_unusable(name):
            rotation = rotation_of_quaternion(quaternion, images_path)
            cameras.append(PhotoCamera(name, _build_lens(*lenses[lens_id]), rotation, np.array(translation, np.float64)))
    return cameras


def measure_model(folder: Path) -> int:
    """Return the bytes of the file with the images of a model in `folder`, 0 if there is none."""
    files = (folder / f"images{extension}" for extension in EXTENSIONS)
    return next((path.stat().st_size for path in files if path.is_file()), 0)


def _build_lens(model: str, width: int, height: int, values: tuple[float, ...]) -> Lens:
    """Return the lens of a model with parameters in the order of COLMAP: focal lengths, center, coefficients."""
    if model in EQUIDISTANT:
        model, coefficients = EQUIDISTANT[model]
        values = (*values, *coefficients)
    if model not in MODELS:
        raise UnusableCameraError(f"its lens model is {model}")
    count = 1 if MODELS[model].is_isotropic else 2
    focal = (values[0], values[count - 1])
    return Lens(model, (width, height), focal, (values[count], values[count + 1]), values[count + 2 :])


def _read_text_cameras(path: Path) -> dict[int, RawLens]:
    lenses = {}
    for line in _read_lines(path):
        if line:
            number, model, width, height, *values = line.split()
            lenses[_to_integer(number)] = (model, _to_integer(width), _to_integer(height), tuple(float(value) for value in values))
    return lenses


def _read_text_images(path: Path) -> list[RawImage]:
    """Return name, camera, quaternion and translation of each image. The line after an image has its 2D points, and may be empty or, in
    files of other programs, missing. COLMAP ignores further empty lines."""
    poses, follows_image = [], False
    for line in _read_lines(path):
        if follows_image and not _is_image(line):
            follows_image = False
        elif line:
            values = line.split(maxsplit=IMAGE_VALUES - 1)
            numbers = tuple(float(value) for value in values[1:8])
            poses.append((values[9], _to_integer(values[8]), numbers[:4], numbers[4:]))
            follows_image = True
    return poses


def _is_image(line: str) -> bool:
    """Return whether a line is that of an image and not of 2D points, which are three numbers each."""
    values = line.split()
    if len(values) < IMAGE_VALUES or not all(map(_is_number, values[: IMAGE_VALUES - 1])):
        return False
    return len(values) % 3 != 0 or not all(map(_is_number, values[IMAGE_VALUES - 1 :]))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_lines(path: Path) -> list[str]:
    """Return the lines of a text file that are no comments, without blanks at their ends."""
    lines = (line.strip() for line in read_text_lines(path))
    return [line for line in lines if not line.startswith("#")]


def _to_integer(text: str) -> int:
    """Return an integer that may be written like 320.0. Raises ValueError for other numbers."""
    number = float(text)
    if not number.is_integer():
        raise ValueError("not an integer")
    return int(number)


def _read_binary_cameras(path: Path) -> dict[int, RawLens]:
    reader, lenses = BinaryReader(read_file(path)), {}
    for _ in range(reader.read_count(24)):
        number, model_number, width, height = reader.read("iiQQ")
        if not 0 <= model_number < len(MODEL_NAMES):
            raise FileError(f'"{path}" has the lens model {model_number}, which Farfield does not know; undistort the photographs first.')
        model = MODEL_NAMES[model_number]
        lenses[number] = (model, width, height, reader.read(f"{PARAMETER_COUNTS[model]}d"))
    return lenses


def _read_binary_images(path: Path) -> list[RawImage]:
    """Return name, camera, quaternion and translation of each image."""
    reader, poses = BinaryReader(read_file(path)), []
    for _ in range(reader.read_count(64)):
        _, *numbers, lens_id = reader.read("i7di")
        name = reader.read_text()
        reader.skip(POINT_BYTES * reader.read_count(POINT_BYTES))
        poses.append((name, lens_id, tuple(numbers[:4]), tuple(numbers[4:])))
    return poses
