"""Textured test meshes: a sphere with texture coordinates at any resolution, and textures for it."""

import numpy as np

from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh


def textured_sphere(rings: int, bumps: float = 0.0) -> TexturedMesh:
    """A sphere of radius 1 with longitude and latitude as texture coordinates, and bumps of this height."""
    polar, azimuth = np.meshgrid(np.linspace(0.0, np.pi, rings + 1), np.linspace(0.0, 2.0 * np.pi, 2 * rings + 1), indexing="ij")
    radii = 1.0 + bumps * np.sin(6.0 * azimuth) * np.sin(polar) ** 2
    points = np.stack([radii * np.sin(polar) * np.cos(azimuth), radii * np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=2)
    points[:, -1] = points[:, 0]
    uvs = np.stack([azimuth / (2.0 * np.pi), 1.0 - polar / np.pi], axis=2).reshape(-1, 2)
    first = (np.arange(rings)[:, None] * (2 * rings + 1) + np.arange(2 * rings)).ravel()
    below = first + 2 * rings + 1
    triangles = np.concatenate([np.stack([first, below, first + 1], axis=1), np.stack([first + 1, below, below + 1], axis=1)])
    return build_textured_mesh(TriangleMesh(points.reshape(-1, 3), triangles.astype(np.int32)), uvs[triangles])


def checkered(size: int = 128, cells: int = 8) -> np.ndarray:
    """A checkerboard (size, size, 3) of two linear colors."""
    y, x = np.mgrid[:size, :size] * cells // size
    return np.where(((x + y) % 2)[..., None], np.float32([0.7, 0.6, 0.4]), np.float32([0.1, 0.2, 0.3]))
