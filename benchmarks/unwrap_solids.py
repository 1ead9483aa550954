"""Solids that Unwrap is measured with: boxes, a bracket, a bolt, a cylinder, a torus and a chair of boxes."""

import numpy as np

from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate

CHAIR_BOXES = [((0.0, 0.0, 0.0), (1.0, 1.0, 0.1)), ((0.0, 0.45, 0.6), (1.0, 0.08, 1.1))]
CHAIR_BOXES += [((x, y, -0.5), (0.1, 0.1, 0.9)) for x in (-0.45, 0.45) for y in (-0.45, 0.45)]
ANGLE = [[0.0, 0.0], [2.0, 0.0], [2.0, 0.4], [0.4, 0.4], [0.4, 2.0], [0.0, 2.0]]
BRACKET = [[0.0, 0.0], [2.0, 0.0], [2.0, 0.3], [0.6, 0.3], [0.3, 0.6], [0.3, 2.0], [0.0, 2.0]]


def build_box(center: tuple[float, float, float], sides: tuple[float, float, float]) -> TriangleMesh:
    """Build a box."""
    half = 0.5 * np.array(sides[:2])
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * half
    body = extrude(square, sides[2])
    return TriangleMesh(body.vertices + center - [0.0, 0.0, 0.5 * sides[2]], body.triangles)


def extrude(outline: np.ndarray, height: float) -> TriangleMesh:
    """Extrude an `outline` (V, 2), all of which its first vertex sees, along the Z axis."""
    count = len(outline)
    bottom = np.array([[0, index, index + 1] for index in range(1, count - 1)])
    vertices = np.concatenate([np.column_stack([outline, np.full(count, z)]) for z in (0.0, height)])
    here, following = np.arange(count), (np.arange(count) + 1) % count
    sides = [np.stack([here, following, following + count], 1), np.stack([here, following + count, here + count], 1)]
    return TriangleMesh(vertices, np.concatenate([bottom[:, ::-1], bottom + count, *sides]).astype(np.int32))


def build_circle(radius: float, sides: int) -> np.ndarray:
    """Build a regular polygon (sides, 2)."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def build_bolt() -> TriangleMesh:
    """Build a bolt of two parts, a hexagonal head and a shaft."""
    shaft = extrude(build_circle(0.5, 32), 3.0)
    return concatenate([extrude(build_circle(1.0, 6), 0.6), TriangleMesh(shaft.vertices - [0.0, 0.0, 3.0], shaft.triangles)])


def build_torus() -> TriangleMesh:
    """Build a torus of 48 by 24 quads."""
    around, across = 48, 24
    turn, tilt = np.meshgrid(2.0 * np.pi * np.arange(around) / around, 2.0 * np.pi * np.arange(across) / across, indexing="ij")
    radius = 1.0 + 0.35 * np.cos(tilt)
    vertices = np.stack([radius * np.cos(turn), radius * np.sin(turn), 0.35 * np.sin(tilt)], axis=-1).reshape(-1, 3)
    ring, belt = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a, b = ring * across + belt, (ring + 1) % around * across + belt
    c, d = (ring + 1) % around * across + (belt + 1) % across, ring * across + (belt + 1) % across
    quads = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2)
    return TriangleMesh(vertices, quads.reshape(-1, 3).astype(np.int32))


SOLIDS = {
    "cube": lambda: build_box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
    "box": lambda: build_box((0.0, 0.0, 0.0), (3.0, 2.0, 1.0)),
    "cylinder": lambda: extrude(build_circle(1.0, 48), 3.0),
    "torus": build_torus,
    "angle": lambda: extrude(np.array(ANGLE), 1.0),
    "bracket": lambda: extrude(np.array(BRACKET), 1.2),
    "bolt": build_bolt,
    "chair_of_boxes": lambda: concatenate([build_box(center, sides) for center, sides in CHAIR_BOXES]),
}
