"""Cameras of COLMAP: the files `cameras` and `images` of a sparse model, as text or binary."""

from pathlib import Path

import numpy as np

from ...errors import FileError
from ...geometry.lenses import MODELS, Lens, PhotoCamera
from .reading import BinaryReader, ReadSize, read_file, read_text_lines, rotation_of_quaternion

EXTENSIONS = (".bin", ".txt")
MODEL_NUMBERS = (  # in binary files
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV", "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE",
)  # fmt: skip
POINT_BYTES = 24  # A 2D point of an image has two coordinates and an ID of 8 bytes each.
IMAGE_VALUES = 10  # ID, quaternion, translation, camera and name
CAMERA_VALUES = 4  # ID, model and size, before the parameters


def read_folder(folder: Path, _read_size: ReadSize) -> list[PhotoCamera]:
    """Read the cameras of all registered images in `folder`, in the order of their names. Raises FileError if a file is missing, cannot be
    read, or refers to something that does not exist."""
    extension = next(each for each in EXTENSIONS if (folder / f"images{each}").is_file())
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
        cameras.append(
            PhotoCamera(name, lenses[lens_id], rotation_of_quaternion(quaternion, images_path), np.array(translation, np.float64))
        )
    return cameras


def _build_lens(model: str, width: int, height: int, values: list[float]) -> Lens:
    """Return the lens of a model with parameters in the order of COLMAP: focal lengths, center, coefficients."""
    if model not in MODELS:
        raise FileError(f'The lens model "{model}" is unknown; Farfield knows {", ".join(MODELS)}.')
    count = 1 if MODELS[model].is_isotropic else 2
    focal = (values[0], values[count - 1])
    return Lens(model, (width, height), focal, (values[count], values[count + 1]), tuple(values[count + 2 :]))


def _read_text_cameras(path: Path) -> dict[int, Lens]:
    lenses = {}
    for line in read_text_lines(path):
        if line.strip() and not line.startswith("#"):
            values = line.split()
            numbers = [float(value) for value in values[CAMERA_VALUES:]]
            lenses[int(values[0])] = _build_lens(values[1], int(values[2]), int(values[3]), numbers)
    return lenses


def _read_text_images(path: Path) -> list[tuple[str, int, tuple[float, ...], tuple[float, ...]]]:
    """Return name, camera, quaternion and translation of each image. Every second line has its 2D points, and may be empty."""
    lines = [line for line in read_text_lines(path) if not line.startswith("#")]
    poses = []
    for line in lines[::2]:
        if line.strip():
            values = line.split(maxsplit=IMAGE_VALUES - 1)
            numbers = tuple(float(value) for value in values[1:8])
            poses.append((values[9].strip(), int(values[8]), numbers[:4], numbers[4:]))
    return poses


def _read_binary_cameras(path: Path) -> dict[int, Lens]:
    reader, lenses = BinaryReader(read_file(path)), {}
    for _ in range(reader.read_count(24)):
        number, model_number, width, height = reader.read("iiQQ")
        if not 0 <= model_number < len(MODEL_NUMBERS):
            raise FileError(f'"{path}" has the lens model {model_number}, which Farfield does not know; undistort the photographs first.')
        model = MODELS[MODEL_NUMBERS[model_number]]
        count = (1 if model.is_isotropic else 2) + 2 + model.coefficient_count
        lenses[number] = _build_lens(MODEL_NUMBERS[model_number], width, height, list(reader.read(f"{count}d")))
    return lenses


def _read_binary_images(path: Path) -> list[tuple[str, int, tuple[float, ...], tuple[float, ...]]]:
    """Return name, camera, quaternion and translation of each image."""
    reader, poses = BinaryReader(read_file(path)), []
    for _ in range(reader.read_count(64)):
        _, *numbers, lens_id = reader.read("i7di")
        name = reader.read_text()
        reader.skip(POINT_BYTES * reader.read_count(POINT_BYTES))
        poses.append((name, lens_id, tuple(numbers[:4]), tuple(numbers[4:])))
    return poses
