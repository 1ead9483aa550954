"""Charts with known answers, and what every layout must be."""

import numpy as np

from farfield.addon.core.mesh import TriangleMesh
from farfield.addon.core.progress import finish
from farfield.addon.core.unwrap.border_barrier import crosses_itself
from farfield.addon.core.unwrap.borders import border_edges
from farfield.addon.core.unwrap.chart import Chart
from farfield.addon.core.unwrap.chart_layout import Border, chart_layout
from farfield.addon.core.unwrap.plane import signed_areas
from shapes import sphere, strip


def chart_of(mesh: TriangleMesh) -> Chart:
    return Chart(mesh.vertices, mesh.triangles, np.ones(len(mesh.triangles)))


def laid_out(chart: Chart, border: Border = Border.FREE, least_ratio: float = 0.0) -> np.ndarray:
    layout = finish(chart_layout(chart, border, least_ratio))
    assert np.isfinite(layout).all()
    assert signed_areas(layout[chart.triangles]).min() > 0.0
    assert not crosses_itself(layout, border_edges(chart.triangles))
    return layout


def dome(rings: int = 16, openness: float = 0.75) -> TriangleMesh:
    """A part of the unit sphere around its pole, `openness` of the way to the other one: a disk that no layout fits without stretch."""
    polar, sides = np.linspace(0.0, np.pi * openness, rings + 1)[1:], 2 * rings
    turn = 2.0 * np.pi * np.arange(sides) / sides
    belts = [np.column_stack([np.sin(a) * np.cos(turn), np.sin(a) * np.sin(turn), np.full(sides, np.cos(a))]) for a in polar]
    here = np.arange(sides)
    ahead = (here + 1) % sides
    inner = np.arange(rings - 1)[:, None] * sides
    belt = strip(inner + here, inner + sides + here, inner + sides + ahead, inner + ahead).reshape(-1, 3)
    cap = np.stack([np.full(sides, rings * sides), here, ahead], axis=1)
    return TriangleMesh(np.concatenate([*belts, [[0.0, 0.0, 1.0]]]), np.concatenate([belt, cap]).astype(np.int32))


def with_holes(rings: int = 18) -> TriangleMesh:
    """A sphere with three round openings."""
    mesh = sphere(rings)
    middles = mesh.vertices[mesh.triangles].mean(axis=1)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    poles = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-0.6, 0.8, 0.0]])
    kept = (middles @ poles.T < [0.7, 0.95, 0.95]).all(axis=1)
    used, triangles = np.unique(mesh.triangles[kept], return_inverse=True)
    return TriangleMesh(mesh.vertices[used], triangles.reshape(-1, 3).astype(np.int32))


def urchin(arms: int = 24, rings: int = 40, length: float = 5.0) -> TriangleMesh:
    """A sphere with long arms of triangular section: closed, and no layout in one piece is any good."""
    ball = sphere(12)
    triangles, vertices, count = ball.triangles.tolist(), [ball.vertices], len(ball.vertices)
    for base in range(0, len(triangles), len(triangles) // arms):
        corners = ball.vertices[triangles[base]]
        way = corners.mean(axis=0) / np.linalg.norm(corners.mean(axis=0))
        last = triangles[base]
        for ring in range(1, rings + 1):
            vertices.append(corners + way * length * ring / rings)
            new = [count, count + 1, count + 2]
            count += 3
            ahead = [1, 2, 0]
            triangles += [[last[here], last[ahead[here]], new[ahead[here]]] for here in range(3)]
            triangles += [[last[here], new[ahead[here]], new[here]] for here in range(3)]
            last = new
        triangles[base] = last
    return TriangleMesh(np.concatenate(vertices), np.array(triangles, np.int32))
