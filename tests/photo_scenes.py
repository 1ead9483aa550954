"""Surfaces, cameras and photographs of them for tests."""

import numpy as np
from scipy.ndimage import gaussian_filter

from farfield.addon.core.geometry.lenses import Lens, PhotoCamera
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.imaging.colors import decode_signed_srgb, encode_signed_srgb
from farfield.addon.core.imaging.images import sample_bilinear
from farfield.addon.core.imaging.raster import locate_pixels
from farfield.addon.core.photos.photographs.observations import Observations
from farfield.addon.core.photos.photographs.photograph import Photograph

SIZE = 128


def grid(side, height=None):
    """A square of 2 x 2 units in the plane z = height(x, y), facing +z, with UVs in 0..1."""
    positions = np.stack(np.meshgrid(np.linspace(-1, 1, side + 1), np.linspace(-1, 1, side + 1)), axis=-1).reshape(-1, 2)
    z = np.zeros(len(positions)) if height is None else height(*positions.T)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    triangles = np.concatenate([
        np.stack([corner, corner + 1, corner + side + 2], axis=1), np.stack([corner, corner + side + 2, corner + side + 1], axis=1)
    ]).astype(np.int32)  # fmt: skip
    return TriangleMesh(np.column_stack([positions, z]), triangles), (0.5 * (positions + 1.0))[triangles].astype(np.float32)


def box():
    """A box of 12 triangles with 8 vertices and one square of the UV map for each side."""
    vertices = np.array([(x, y, z) for z in (-0.8, 0.8) for y in (-1.0, 1.0) for x in (-1.2, 1.2)])
    sides = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = np.array([[side[0], side[i], side[i + 1]] for side in sides for i in (1, 2)], np.int32)
    square = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.45], [0.0, 0.45]])
    uvs = [square[[0, i, i + 1]] + [0.33 * (k % 3) + 0.02, 0.5 * (k // 3) + 0.02] for k in range(6) for i in (1, 2)]
    return TriangleMesh(vertices, triangles), np.array(uvs, np.float32)


def camera_at(position, target=(0.0, 0.0, 0.0), size=(300, 240), focal=300.0, name="photo.png"):
    """A pinhole camera at `position` that looks at `target`, with y pointing down in the photograph."""
    position = np.array(position, float)
    forward = np.array(target, float) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.1])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    lens = Lens("SIMPLE_PINHOLE", size, (focal, focal), (size[0] / 2, size[1] / 2), ())
    return PhotoCamera(name, lens, rotation, -rotation @ position)


def photograph(mesh, corner_uvs, texture, camera, gain=1.0):
    """Render a mesh with an encoded texture."""
    positions, depths, _ = camera.project(mesh.vertices)
    located = locate_pixels(positions[mesh.triangles], depths[mesh.triangles], camera.lens.size)
    image = np.zeros((*located.covered.shape, texture.shape[2]), np.float32)
    image[located.covered] = sample_bilinear(texture, located.interpolate(corner_uvs) * texture.shape[1::-1])
    encoded = np.clip(encode_signed_srgb(decode_signed_srgb(image) * np.float32(gain)), 0.0, 1.0)
    return Photograph(camera, np.rint(255.0 * encoded).astype(np.uint8))


def smooth_texture(seed=1):
    random = np.random.default_rng(seed)
    y, x = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE
    waves = [
        np.sin(2 * np.pi * (a * x + b * y) + c) for a, b, c in zip(*random.uniform(-4, 4, (2, 3)), random.uniform(0, 6, 3), strict=True)
    ]
    return (0.5 + 0.25 * np.stack(waves, axis=-1)).astype(np.float32)


def detailed_texture(seed=0, side=256):
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(side, side, 3)), (2.0, 2.0, 0.0))
    return (0.5 + 0.12 * noise / noise.std()).astype(np.float32)


def distance_in_pixels(mesh, camera, truth):
    """How far vertices are projected from where they should be, in the mean."""
    return float(np.linalg.norm(camera.project(mesh.vertices)[0] - truth.project(mesh.vertices)[0], axis=1).mean())


def ring(count, radius=1.2, height=3.0):
    angles = 2 * np.pi * np.arange(count) / count
    return [camera_at((radius * np.cos(a), radius * np.sin(a), height), name=f"{k}.png") for k, a in enumerate(angles)]


def observations(linear, visible, positions=None):
    """Observations of points with `linear` colors (K, P, 3) in photographs, where `visible` (K, P)."""
    points, photographs = np.nonzero(visible.T)
    colors = encode_signed_srgb(linear[photographs, points].astype(np.float32))
    found = np.zeros((len(points), 2)) if positions is None else positions[photographs, points]
    return Observations(points, photographs, found.astype(np.float32), colors)
