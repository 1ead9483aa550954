"""Charts with known answers, and the properties that every parameterization must have."""

import numpy as np

from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.geometry.transforms import signed_areas
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.cutting.boundaries import boundary_edges
from farfield.addon.core.unwrap.cutting.chart import Chart
from farfield.addon.core.unwrap.energies.boundary_barrier import self_intersects
from farfield.addon.core.unwrap.parameterization.parameterize import Balance, Boundary, parameterize
from shapes import sphere, split_quads


def chart_of(mesh: TriangleMesh) -> Chart:
    return Chart(mesh.vertices, mesh.triangles, np.ones(len(mesh.triangles)))


def parameterize_and_check(
    chart: Chart, boundary: Boundary = Boundary.FREE, min_quality: float = 0.0, balance: Balance = Balance.BALANCED
) -> np.ndarray:
    uv = run_to_end(parameterize(chart, boundary, min_quality, balance))
    assert np.isfinite(uv).all()
    assert signed_areas(uv[chart.triangles]).min() > 0.0
    assert not self_intersects(uv, boundary_edges(chart.triangles))
    return uv


def dome(rings: int = 16, polar_fraction: float = 0.75) -> TriangleMesh:
    """Return a cap of the unit sphere, `polar_fraction` of the way to the other pole: a disk that only unwraps with stretch."""
    polar, sides = np.linspace(0.0, np.pi * polar_fraction, rings + 1)[1:], 2 * rings
    angles = 2.0 * np.pi * np.arange(sides) / sides
    belts = [np.column_stack([np.sin(a) * np.cos(angles), np.sin(a) * np.sin(angles), np.full(sides, np.cos(a))]) for a in polar]
    index = np.arange(sides)
    following = (index + 1) % sides
    inner = np.arange(rings - 1)[:, None] * sides
    belt = split_quads(inner + index, inner + sides + index, inner + sides + following, inner + following).reshape(-1, 3)
    cap = np.stack([np.full(sides, rings * sides), index, following], axis=1)
    return TriangleMesh(np.concatenate([*belts, [[0.0, 0.0, 1.0]]]), np.concatenate([belt, cap]).astype(np.int32))


def sphere_with_holes(rings: int = 18) -> TriangleMesh:
    """A sphere with three round openings."""
    mesh = sphere(rings)
    directions = mesh.vertices[mesh.triangles].mean(axis=1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    poles = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-0.6, 0.8, 0.0]])
    is_kept = (directions @ poles.T < [0.7, 0.95, 0.95]).all(axis=1)
    used, triangles = np.unique(mesh.triangles[is_kept], return_inverse=True)
    return TriangleMesh(mesh.vertices[used], triangles.reshape(-1, 3).astype(np.int32))


def urchin(arms: int = 24, rings: int = 40, length: float = 5.0) -> TriangleMesh:
    """A closed sphere with long triangular arms, which has no good parameterization in one piece."""
    ball = sphere(12)
    triangles, vertices, count = ball.triangles.tolist(), [ball.vertices], len(ball.vertices)
    for base in range(0, len(triangles), len(triangles) // arms):
        corners = ball.vertices[triangles[base]]
        direction = corners.mean(axis=0) / np.linalg.norm(corners.mean(axis=0))
        last = triangles[base]
        for ring in range(1, rings + 1):
            vertices.append(corners + direction * length * ring / rings)
            new = [count, count + 1, count + 2]
            count += 3
            following = [1, 2, 0]
            triangles += [[last[side], last[following[side]], new[following[side]]] for side in range(3)]
            triangles += [[last[side], new[following[side]], new[side]] for side in range(3)]
            last = new
        triangles[base] = last
    return TriangleMesh(np.concatenate(vertices), np.array(triangles, np.int32))


def torus(around=24, across=12, handles=1, tube_radius=0.4):
    """A row of tori, joined by tubes where a quad of each is removed: a surface with that many handles."""
    vertices, triangles = [], []
    for index in range(handles):
        turn, tilt = np.meshgrid(2.0 * np.pi * np.arange(around) / around, 2.0 * np.pi * np.arange(across) / across, indexing="ij")
        radius = 1.0 + tube_radius * np.cos(tilt)
        positions = np.stack([radius * np.cos(turn) + 4.0 * index, radius * np.sin(turn), tube_radius * np.sin(tilt)], axis=-1)
        vertices.append(positions.reshape(-1, 3))
        ring, belt = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
        a, b = ring * across + belt, (ring + 1) % around * across + belt
        c, d = (ring + 1) % around * across + (belt + 1) % across, ring * across + (belt + 1) % across
        faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 2, 3)
        triangles.append(faces + index * around * across)
    if handles == 2:
        first, second = triangles[0][0, 0].tolist() + [triangles[0][0, 1, 2]], triangles[1][0, 0].tolist() + [triangles[1][0, 1, 2]]
        bridge = []
        for side in range(4):
            a, b = first[side], first[(side + 1) % 4]
            c, d = second[-side % 4], second[(-side - 1) % 4]
            bridge += [[[a, b, d], [a, d, c]]]
        triangles = [triangles[0][1:], triangles[1][1:], np.array(bridge)]
    return np.concatenate(vertices), np.concatenate(triangles).reshape(-1, 3).astype(np.int32)
