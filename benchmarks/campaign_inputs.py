"""Input files for campaigns: valid ones of every format that the scripts read, damaged copies of them, and paths that are not files."""

import csv
import gzip
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random

import bpy
import campaign_scenes
import numpy as np

import image_data
import random_images
import random_inputs
import terrain_files
from lib import scene_files

MESH_SUFFIXES = (".blend", ".obj", ".ply", ".stl", ".glb", ".gltf", ".fbx", ".usda", ".usdc")
TERRAIN_SUFFIXES = (".npy", ".tif", ".nii", ".nii.gz", ".raw", ".png", ".vdb")
IMAGE_SUFFIXES = (".png", ".tif", ".jpg", ".exr")
FILE_STEMS = ("mesh", "Größe 樹", "-mesh", "a b", "x.y", "quote'", "100%")


class Samples:
    """Valid files, each created when it is first needed. `folder` holds them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def mesh_file(self, suffix: str) -> Path:
        """Return a file with a mesh that has a material and a UV map."""
        return self._create("mesh" + suffix, _write_mesh_file)

    def cloud_file(self) -> Path:
        """Return a .blend file with a ball and its cloud."""
        return self._create("cloud.blend", _write_cloud_file)

    def baked_file(self) -> Path:
        """Return a .blend file with a ball and its relightable cloud."""
        return self._create("baked.blend", _write_baked_file)

    def terrain_file(self, suffix: str, random: Random) -> Path:
        """Return a height map or a volume; `random` chooses between them where a format stores both."""
        if suffix == ".npy":
            return self._create(random.choice(("heights.npy", "volume.npy")), _write_terrain_file)
        return self._create("volume_6x7x8_uint8.raw" if suffix == ".raw" else "terrain" + suffix, _write_terrain_file)

    def height_file(self, suffix: str) -> Path:
        """Return an elevation model of one of the formats of large terrain."""
        return self._create(("N46E008" if suffix == ".hgt" else "heights") + suffix, _write_height_file)

    def store(self) -> Path:
        """Return the folder of a large terrain with a texture."""
        return self._create("store", _write_store)

    def package(self) -> Path:
        """Return the folder of a package."""
        return self._create("package", _write_package)

    def photo_project(self) -> Path:
        """Return a folder with a plane, photographs of it and their cameras."""
        return self._create("project", _write_photo_project)

    def _create(self, name: str, write: Callable[[Path], None]) -> Path:
        path = self.folder / name
        if not path.exists():
            write(path)
        return path


def write_mesh(random: Random, folder: Path) -> Path:
    """Write a random mesh as text."""
    mesh, path = random_inputs.random_mesh(random), folder / random.choice(FILE_STEMS)
    if random.random() < 0.5:
        path = path.with_name(path.name + random.choice((".obj", ".obj", ".OBJ")))
        path.write_bytes(mesh.to_obj(random_inputs.random_name(random)))
    else:
        path = path.with_name(path.name + ".ply")
        path.write_bytes(mesh.to_ply())
    return path


def write_images(random: Random, folder: Path) -> tuple[Path, Path]:
    """Write a random image and a mask for it, which sometimes has another size; one of them is sometimes damaged."""
    stored = random_images.random_image(random)
    suffix = random.choice(IMAGE_SUFFIXES[:3] if stored.dtype.kind == "u" else IMAGE_SUFFIXES[1:2] + IMAGE_SUFFIXES[3:])
    if suffix == ".jpg":
        stored = (stored >> 8 * (stored.itemsize - 1)).astype(np.uint8)[..., : 3 if stored.shape[2] > 2 else 1]
    size = stored.shape[:2] if random.random() < 0.93 else (9, 11)
    mask = random_images.random_mask(random, size)[..., None]
    paths = [folder / (random.choice(FILE_STEMS) + suffix), folder / ("mask" + random.choice(IMAGE_SUFFIXES[:3]))]
    for path, pixels in zip(paths, (stored, mask), strict=True):
        image_data.write_image(path, pixels)
        if random.random() < 0.1:
            path.write_bytes(random_inputs.damage(random, path.read_bytes()))
    return paths[0], paths[1]


def write_scene(random: Random, folder: Path) -> Path:
    """Write a random scene as a .blend file."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    campaign_scenes.build_scene(random, folder)
    path = folder / (random.choice(FILE_STEMS) + ".blend")
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=random.random() < 0.5, check_existing=False)
    return path


def write_damaged(random: Random, sample: Path, folder: Path) -> Path:
    """Write a damaged copy of a valid file. Its suffix is sometimes that of another format."""
    content = sample.read_bytes()
    if sample.suffix == ".gz" and random.random() < 0.5:
        content = gzip.compress(random_inputs.damage(random, gzip.decompress(content)))
    else:
        content = random_inputs.damage(random, content)
    path = folder / sample.name
    if random.random() < 0.1:
        path = path.with_suffix(random.choice(MESH_SUFFIXES + TERRAIN_SUFFIXES))
    path.write_bytes(content)
    return path


def write_path(random: Random, folder: Path) -> Path:
    """Write a .csv file of positions, which is sometimes damaged."""
    path = folder / "path.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if random.random() < 0.3:
            writer.writerow(["x", "y", "z"])
        writer.writerows([[random.uniform(-50.0, 50.0) for _ in range(3)] for _ in range(random.randint(0, 3))])
    if random.random() < 0.3:
        path.write_bytes(random_inputs.damage(random, path.read_bytes()))
    return path


def odd_path(random: Random, folder: Path, suffix: str) -> Path:
    """Return a path that is not an ordinary file, or does not exist."""
    path = folder / f"odd{suffix}"
    choice = random.randrange(9)
    if choice == 0:
        path.mkdir()
    elif choice == 1:
        path.symlink_to(path.name)  # a loop
    elif choice == 2 and hasattr(os, "mkfifo"):
        os.mkfifo(path)
    elif choice == 3:
        return folder / ("x" * 300 + suffix)
    elif choice == 4:
        path = folder / os.fsdecode(b"\xff" + suffix.encode())
        with suppress(OSError):
            path.write_bytes(b"o x\n")
    elif choice == 5:
        path = folder / random.choice(("no suffix", "file.xyz", f"{suffix}", f"line\nbreak{suffix}"))
        path.write_bytes(b"text")
    elif choice == 6:
        path.write_bytes(b"")
    elif choice == 7:
        return Path(random.choice(("", ".", "/", "~", "//missing" + suffix)))
    return path


def _write_mesh_file(path: Path) -> None:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=1, calc_uvs=True)
    bpy.context.object.data.materials.append(bpy.data.materials.new("Red"))
    name = str(path)
    exporters: dict[str, Callable[[], set[str]]] = {
        ".blend": lambda: bpy.ops.wm.save_as_mainfile(filepath=name, compress=False, check_existing=False),
        ".obj": lambda: bpy.ops.wm.obj_export(filepath=name),
        ".ply": lambda: bpy.ops.wm.ply_export(filepath=name, export_uv=True),
        ".stl": lambda: bpy.ops.wm.stl_export(filepath=name),
        ".glb": lambda: bpy.ops.export_scene.gltf(filepath=name, export_format="GLB"),
        ".gltf": lambda: bpy.ops.export_scene.gltf(filepath=name, export_format="GLTF_SEPARATE"),
        ".fbx": lambda: bpy.ops.export_scene.fbx(filepath=name),
    }
    exporters.get(path.suffix, lambda: bpy.ops.wm.usd_export(filepath=name))()


def _write_cloud_file(path: Path) -> None:
    from bridge import bakes, blender_scenes

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=2)
    bpy.context.object.data.materials.append(blender_scenes.create_material("Red", (0.8, 0.2, 0.1), 1.0))
    bakes.build_cloud(bpy.context.object)
    scene_files.save_scene(path)


def _write_baked_file(path: Path) -> None:
    from bridge import bakes
    from farfield.addon.core.jobs.progress import run_to_end
    from farfield.addon.operators.job_run import run_job

    _write_cloud_file(path)
    run_to_end(run_job(bakes.prepare_job(bakes.open_cloud(path), None)))
    scene_files.save_scene(path)


def _write_height_file(path: Path) -> None:
    heights = np.add.outer(np.arange(21.0), 2.0 * np.arange(25.0))
    if path.suffix == ".asc":
        rows = "\n".join(" ".join(f"{value:g}" for value in row) for row in heights)
        path.write_text(f"ncols 25\nnrows 21\nxllcorner 0\nyllcorner 0\ncellsize 10\nNODATA_value -9999\n{rows}\n", encoding="ascii")
    elif path.suffix == ".hgt":
        np.add.outer(np.arange(1201), np.arange(1201)).astype(">i2").tofile(path)
    else:
        _write_terrain_file(path)


def _write_store(path: Path) -> None:
    import small_terrain_stores

    small_terrain_stores.build_store(path, small_terrain_stores.hills(33, 41))
    small_terrain_stores.add_texture(path, small_terrain_stores.colors(256))


def _write_package(path: Path) -> None:
    from textured_scenes import textured_ball

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    textured_ball(8)
    bpy.ops.farfield.packages_export(folder=str(path), views=2, max_image=32, levels="number", number=2, pixels=32, tile_size=32)


def _write_photo_project(path: Path) -> None:
    import campaign_projects

    campaign_projects.write_photo_project(path)


def _write_terrain_file(path: Path) -> None:
    heights = np.add.outer(np.arange(12.0), np.arange(10.0))
    volume = (np.hypot(*np.mgrid[-3:3, -3:4]) < 3.0)[..., None].repeat(8, axis=2).astype(np.uint8) * 200
    if path.suffix == ".png":
        terrain_files.write_png(path, heights.astype(np.uint8))
    elif path.suffix == ".tif":
        terrain_files.write_geotiff(path, heights.astype(np.float32), (10.0, 10.0), (0.0, 0.0))
    elif path.suffix == ".vdb":
        from farfield.addon.bridge.clipbox import openvdb_worker

        openvdb = openvdb_worker.import_openvdb(Path())
        openvdb.write(str(path), [openvdb.createLevelSetSphere(radius=6.0, voxelSize=1.0)])
    elif path.name == "heights.npy":
        np.save(path, heights)
    elif path.suffix == ".raw":
        path.write_bytes(volume.tobytes(order="F"))
    else:
        terrain_files.write_voxels(path, volume)
