"""Random command lines of the scripts with commands and folders: texmesh, packages, photos, bdam."""

import json
import shutil
from contextlib import suppress
from pathlib import Path
from random import Random

import bpy
import numpy as np
from campaign_inputs import MESH_SUFFIXES, Samples, odd_path, write_damaged, write_mesh, write_scene

import random_inputs

HEIGHT_SUFFIXES = (".npy", ".tif", ".png", ".hgt", ".asc")
CAMERA_FILES = ("transforms.json", "cameras.txt", "bundle.out", "scene.nvm", "cameras.sfm", "chunk.xml", "points.pairs")
STRUCTURE_VALUES = (0, -1, 2**40, 1e308, "x", None, [], [1], {}, True, 1.5)
PHOTO_SIDE = 24
# The cameras stand above the plane.
POSITIONS = ((1.2, 0.0, 3.0), (0.0, 1.2, 3.0), (-1.2, 0.0, 3.0), (0.0, -1.2, 3.0))


def mesh_input(random: Random, folder: Path, samples: Samples) -> Path:
    """Return a mesh file: random, a scene, valid, damaged, or no file."""
    choice = random.random()
    if choice < 0.2:
        return write_mesh(random, folder)
    if choice < 0.4:
        return write_scene(random, folder)
    sample = samples.mesh_file(random.choice(MESH_SUFFIXES))
    if choice < 0.7:
        return Path(shutil.copy(sample, folder))
    return write_damaged(random, sample, folder) if choice < 0.95 else odd_path(random, folder, random.choice(MESH_SUFFIXES))


def texmesh_arguments(random: Random, folder: Path, samples: Samples) -> tuple[list[str], Path]:
    """Return the command with its input, and the input."""
    source = mesh_input(random, folder, samples)
    return [random.choice(("levels", "levels", "levels", "analyze")), str(source)], source


def packages_arguments(random: Random, folder: Path, samples: Samples) -> tuple[list[str], Path]:
    """Return the command with its input, and the input: a mesh, or the folder of a package."""
    if random.random() < 0.6:
        source = mesh_input(random, folder, samples)
        return ["build", str(source)], source
    source = damaged_folder(random, samples.package(), folder / "package")
    return ["verify", str(source)], source


def bdam_arguments(random: Random, folder: Path, samples: Samples) -> tuple[list[str], Path]:
    """Return the command with its inputs, and one of them: elevation models, or a store."""
    if random.random() < 0.5:
        sources = []
        for index in range(random.choice((1, 1, 1, 2))):
            sample = samples.height_file(random.choice(HEIGHT_SUFFIXES))
            place = folder / f"heights-{index}"
            place.mkdir()
            sources.append(Path(shutil.copy(sample, place)) if random.random() < 0.5 else write_damaged(random, sample, place))
        if random.random() < 0.1:
            sources[-1] = odd_path(random, folder, random.choice(HEIGHT_SUFFIXES))
        arguments = ["build", *map(str, sources)]
        if random.random() < 0.3:
            image = samples.height_file(".png")
            arguments += ["--texture", str(write_damaged(random, image, folder) if random.random() < 0.5 else image)]
        return arguments, sources[0]
    source = damaged_folder(random, samples.store(), folder / "store")
    command = random.choice(("info", "verify", "extract"))
    position = ",".join(str(random.choice((0.0, 30.0, 500.0, -1e6, float("nan")))) for _ in range(3))
    return [command, str(source), *(["--from", position, "--to", "0,0,0", "--size", "64x48"] if command == "extract" else [])], source


def photos_arguments(random: Random, folder: Path, samples: Samples) -> tuple[list[str], Path]:
    """Return the arguments with mesh, cameras and photographs, and the mesh."""
    project = Path(shutil.copytree(samples.photo_project(), folder / "project"))
    source = project / "plane.obj" if random.random() < 0.7 else mesh_input(random, folder, samples)
    cameras = project / "transforms.json"
    choice = random.random()
    if choice < 0.35:
        cameras.write_bytes(random_inputs.damage(random, cameras.read_bytes()))
    elif choice < 0.6:
        change_json(random, cameras)
    elif choice < 0.7:
        cameras = cameras.rename(project / random.choice(CAMERA_FILES))
    elif choice < 0.75:
        cameras = odd_path(random, folder, ".json")
    if random.random() < 0.3:
        photograph = random.choice(sorted((project / "images").glob("*.png")))
        photograph.write_bytes(random_inputs.damage(random, photograph.read_bytes()))
    arguments = [str(source), "--cameras", str(cameras), "--images", str(project / "images")]
    if random.random() < 0.2:
        arguments += ["--masks", str(project / random.choice(("images", "none")))]
    if random.random() < 0.1:
        arguments.append("--refine")
    return arguments, source


def damaged_folder(random: Random, sample: Path, folder: Path) -> Path:
    """Return a copy of a folder in which something is damaged, missing or exchanged, or nothing."""
    shutil.copytree(sample, folder)
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    for _ in range(random.choice((0, 1, 1, 2, 4))):
        path, choice = random.choice(paths), random.random()
        if not path.exists():
            continue
        if choice < 0.4:
            path.write_bytes(random_inputs.damage(random, path.read_bytes()))
        elif choice < 0.5:
            path.unlink()
        elif choice < 0.6:
            other = random.choice(paths)
            path.write_bytes(other.read_bytes() if other.exists() else b"")
        elif path.suffix == ".json":
            change_json(random, path)
        else:
            change_header(random, path)
    return folder


def change_json(random: Random, path: Path) -> None:
    """Give a random value in a JSON file another type or size, unless it is damaged already."""
    try:
        document = json.loads(path.read_bytes())
    except ValueError:
        return
    place, parent = document, None
    while isinstance(place, dict | list) and place and (parent is None or random.random() < 0.8):
        parent, key = place, random.choice(list(place) if isinstance(place, dict) else range(len(place)))
        place = parent[key]
    if parent is not None:
        parent[key] = random.choice(STRUCTURE_VALUES)
    path.write_text(json.dumps(document), encoding="utf-8")


def change_header(random: Random, path: Path) -> None:
    """Change digits near the beginning of a file, where headers are text."""
    content = bytearray(path.read_bytes())
    places = [index for index, byte in enumerate(content[: 1 << 16]) if 48 <= byte <= 57]
    for place in random.sample(places, min(len(places), random.choice((1, 2, 8)))):
        content[place] = random.choice(b"0123456789-.e")
    path.write_bytes(content)


def _add_textured_ball(random: Random, _folder: Path, _samples: Samples) -> None:
    """Add a selected ball with an image, which mostly has levels."""
    from textured_scenes import textured_ball

    textured_ball(random.choice((6, 8)))
    if random.random() < 0.5:
        bpy.ops.farfield.texmesh_levels(views=2, max_image=32, levels="number", number=2)


def _import_cameras(random: Random, folder: Path, samples: Samples) -> None:
    """Add the plane of a project, and mostly its cameras."""
    project = shutil.copytree(samples.photo_project(), folder / "project")
    bpy.ops.wm.obj_import(filepath=str(project / "plane.obj"))
    if random.random() < 0.8:
        with suppress(RuntimeError):
            bpy.ops.farfield.photos_import_cameras(filepath=str(project / "transforms.json"))


def _load_store(random: Random, folder: Path, samples: Samples) -> None:
    """Load a terrain, which may be damaged."""
    store = damaged_folder(random, samples.store(), folder / "store")
    with suppress(RuntimeError):
        bpy.ops.farfield.bdam_load(directory=str(store))


PREPARATIONS = {"texmesh": _add_textured_ball, "packages": _add_textured_ball, "photos": _import_cameras, "bdam": _load_store}


def write_photo_project(folder: Path) -> None:
    """Write a plane of two triangles, four photographs of it, and their cameras as transforms.json."""
    import image_data

    (folder / "images").mkdir(parents=True)
    (folder / "plane.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n")
    frames = []
    for index, position in enumerate(POSITIONS):
        image_data.write_image(folder / "images" / f"IMG {index}.png", np.full((PHOTO_SIDE, PHOTO_SIDE, 3), 60 + 40 * index, np.uint8))
        backward = np.array(position) / np.linalg.norm(position)
        right = np.cross([0.0, 1.0, 0.0], backward)
        right /= np.linalg.norm(right)
        matrix = np.eye(4)
        matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = right, np.cross(backward, right), backward, position
        frames.append({"file_path": f"images/IMG {index}.png", "transform_matrix": matrix.tolist()})
    lens = {"fl_x": 30.0, "fl_y": 30.0, "cx": PHOTO_SIDE / 2, "cy": PHOTO_SIDE / 2, "w": PHOTO_SIDE, "h": PHOTO_SIDE}
    (folder / "transforms.json").write_text(json.dumps(lens | {"frames": frames}), encoding="utf-8")
