"""Other programs that make textures from photographs, for `bench_photos.py`. Runs in the environment of the texture tools.

    photos_peers.py METHOD INPUT.npz OUTPUT.npy

METHOD is `lagrange`, `pymeshlab`, or `lagrange-fill`, which fills the holes of a texture. The input has vertices (V, 3), triangles (T, 3),
corner_uvs (T, 3, 2), pixels (K, H, W, 3) uint8 with row 0 at the top, and the pinhole cameras: rotations (K, 3, 3) and translations (K, 3)
from the world to the camera, which looks along +z with y down, focal (K,) and centers (K, 2) in pixels from the upper left corner; size,
the pixels per side of the texture. To fill holes, it has a texture (S, S, 3) uint8 with row 0 at the bottom and known (S, S) bool instead
of photographs. The output is a texture (S, S, 3) uint8 with row 0 at the bottom. Prints the seconds without input and output as JSON.
"""

import json
import os
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

FLIP = np.diag([1.0, -1.0, -1.0])  # from cameras along +z with y down to cameras along -z with y up
NEAR, FAR = 0.01, 100.0  # Relative to the distance from the camera to the mesh.

Input = Mapping[str, np.ndarray]


def with_lagrange(given: Input, size: int) -> np.ndarray:
    """Call the compositing of gradients in Lagrange."""
    import lagrange

    mesh = _lagrange_mesh(given)
    cameras, renders = [], []
    height, width = given["pixels"].shape[1:3]
    for rotation, translation, focal, center, pixels in _photographs(given):
        camera = lagrange.core.CameraTransforms()
        view = np.eye(4, dtype=np.float32)
        view[:3, :3], view[:3, 3] = FLIP @ rotation, FLIP @ translation
        distances = np.linalg.norm(given["vertices"] @ rotation.T + translation, axis=1)
        near, far = NEAR * distances.min(), FAR * distances.max()
        projection = np.zeros((4, 4), np.float32)
        projection[0] = [2.0 * focal / width, 0.0, 1.0 - 2.0 * center[0] / width, 0.0]
        projection[1] = [0.0, 2.0 * focal / height, 2.0 * center[1] / height - 1.0, 0.0]
        projection[2] = [0.0, 0.0, -(far + near) / (far - near), -2.0 * far * near / (far - near)]
        projection[3, 2] = -1.0
        camera.view, camera.projection = view, projection
        cameras.append(camera)
        renders.append(np.ascontiguousarray(pixels.astype(np.float32) / 255.0))
    colors, weights = lagrange.texproc.rasterize_textures_from_renders(mesh, cameras, renders, width=size, height=size)
    try:
        image = lagrange.texproc.texture_compositing(mesh, colors, weights, clamp_to_range=(0.0, 1.0))
    except RuntimeError:  # multigrid fails on some UV maps
        image = lagrange.texproc.texture_compositing(mesh, colors, weights, clamp_to_range=(0.0, 1.0), use_direct_solver=True)
    return np.rint(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)[::-1]


def fill_with_lagrange(given: Input, _: int) -> np.ndarray:
    """Call the compositing of gradients in Lagrange with one texture that has no weight in its holes."""
    import lagrange

    texture = np.ascontiguousarray(given["texture"][::-1].astype(np.float32) / 255.0)
    weights = np.ascontiguousarray(given["known"][::-1, :, None].astype(np.float32))
    mesh = _lagrange_mesh(given)
    try:
        image = lagrange.texproc.texture_compositing(mesh, [texture], [weights], clamp_to_range=(0.0, 1.0))
    except RuntimeError:
        image = lagrange.texproc.texture_compositing(mesh, [texture], [weights], clamp_to_range=(0.0, 1.0), use_direct_solver=True)
    return np.rint(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)[::-1]


def _lagrange_mesh(given: Input) -> "lagrange.SurfaceMesh":  # noqa: F821 (only in the environment of the texture tools)
    import lagrange

    mesh = lagrange.SurfaceMesh()
    mesh.add_vertices(given["vertices"].astype(np.float64))
    mesh.add_triangles(given["triangles"].astype(np.uint32))
    corners = np.concatenate([given["corner_uvs"].reshape(-1, 2), given["triangles"].reshape(-1, 1)], axis=1, dtype=np.float64)
    uvs, indices = np.unique(corners, axis=0, return_inverse=True)
    mesh.create_attribute(
        "uv",
        element=lagrange.AttributeElement.Indexed,
        usage=lagrange.AttributeUsage.UV,
        initial_values=np.ascontiguousarray(uvs[:, :2]),
        initial_indices=indices.ravel().astype(np.uint32),
    )
    return mesh


def with_pymeshlab(given: Input, size: int) -> np.ndarray:
    """Call the projection of rasters in MeshLab, with its default weights."""
    import pymeshlab
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = None
    height, width = given["pixels"].shape[1:3]
    with tempfile.TemporaryDirectory() as folder:
        rasters = []
        for index, (rotation, translation, focal, center, pixels) in enumerate(_photographs(given)):
            Image.fromarray(pixels).save(Path(folder) / f"{index}.png")
            turned = np.eye(4)
            turned[:3, :3] = FLIP @ rotation
            position = -rotation.T @ translation
            rasters.append(
                f'<MLRaster label="{index}"><VCGCamera CameraType="0" BinaryData="0" FocalMm="{focal:.9g}" PixelSizeMm="1 1" '
                f'ViewportPx="{width} {height}" CenterPx="{center[0]:.9g} {center[1]:.9g}" LensDistortion="0 0" '
                f'TranslationVector="{_join(-position)} 1" RotationMatrix="{_join(turned.ravel())}"/>'
                f'<Plane semantic="" fileName="{index}.png"/></MLRaster>'
            )
        project = Path(folder) / "project.mlp"
        project.write_text(
            f"<!DOCTYPE MeshLabDocument><MeshLabProject><RasterGroup>{''.join(rasters)}</RasterGroup></MeshLabProject>", encoding="utf-8"
        )
        meshes = pymeshlab.MeshSet()
        meshes.load_project(str(project))
        meshes.add_mesh(
            pymeshlab.Mesh(
                vertex_matrix=given["vertices"].astype(np.float64),
                face_matrix=given["triangles"].astype(np.int32),
                w_tex_coords_matrix=given["corner_uvs"].reshape(-1, 2).astype(np.float64),
            )
        )
        meshes.compute_color_and_texture_from_active_rasters_projection(textname="texture.png", texsize=size)
        meshes.save_current_mesh(str(Path(folder) / "mesh.obj"), save_textures=True)
        return np.array(Image.open(Path(folder) / "texture.png").convert("RGB"))[::-1]


def _photographs(given: Input) -> zip:
    return zip(given["rotations"], given["translations"], given["focal"], given["centers"], given["pixels"], strict=True)


def _join(values: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in values)


METHODS = {"lagrange": with_lagrange, "pymeshlab": with_pymeshlab, "lagrange-fill": fill_with_lagrange}


def main() -> None:
    """Answer the request of the command line."""
    method, source, target = sys.argv[1:]
    with np.load(source, allow_pickle=False) as file:
        given = dict(file)
    started = time.perf_counter()
    image = METHODS[method](given, int(given["size"]))
    seconds = time.perf_counter() - started
    np.save(target, np.ascontiguousarray(image))
    print(json.dumps({"seconds": seconds}), flush=True)
    os._exit(0)  # MeshLab's plugins may crash when they are unloaded without a window system


if __name__ == "__main__":
    main()
