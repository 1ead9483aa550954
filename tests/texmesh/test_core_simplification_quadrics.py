"""Quadrics of position and texture coordinates: known distances, and costs given by the caller."""

import numpy as np
import pytest

from farfield.addon.core.geometry.distance import closest_on_mesh
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.engine import CollapseEngine, WedgeMoves
from farfield.addon.core.texmesh.simplification.levels import simplify_by_cost, simplify_in_order
from farfield.addon.core.texmesh.simplification.removal_orders import LENGTH_WEIGHT, TextureQuadrics
from farfield.addon.core.texmesh.simplification.topology import Collapses
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from textured_models import plane, torus


def rate(mesh: TexturedMesh, vertices: np.ndarray) -> tuple[Collapses, np.ndarray]:
    """Return the collapses of `vertices` and their costs."""
    engine = CollapseEngine(mesh)
    collapses = engine.topology.find_collapses(vertices, engine.groups)[1]
    return collapses, TextureQuadrics(mesh).evaluate(collapses, engine.find_moves(collapses))


def center_of(mesh: TexturedMesh, x: float, y: float) -> np.ndarray:
    return np.flatnonzero((mesh.vertices[:, 0] == x) & (mesh.vertices[:, 1] == y)).astype(np.int32)


def test_collapses_within_a_plane_cost_nothing_but_their_length():
    mesh = plane(6, 6)
    collapses, costs = rate(mesh, center_of(mesh, 3.0, 3.0))
    squares = ((mesh.vertices[collapses.removed] - mesh.vertices[collapses.kept]) ** 2).sum(axis=1) / 6.0**2
    assert len(squares) == 6
    np.testing.assert_allclose(costs, LENGTH_WEIGHT * squares / 36.0, rtol=1e-6, atol=1e-15)


def test_the_cost_of_leaving_a_plane_is_the_squared_height_by_area():
    """A peak on a plane: the vertex next to it stands for two triangles of the peak and four of the plane."""
    heights = np.zeros((7, 7))
    heights[3, 4] = 1e-3
    mesh = plane(6, 6, heights)
    neighbor, peak = center_of(mesh, 2.0, 3.0), center_of(mesh, 4.0, 3.0)
    collapses, costs = rate(mesh, center_of(mesh, 3.0, 3.0))
    flat, onto_peak = costs[collapses.kept == neighbor], costs[collapses.kept == peak]
    # Four of six triangles of 1/2 at the vertex are flat, each counts by a third of its area; of the peak's own, all contain it.
    height, area = 1e-3 / 6.0, 0.5 / 36.0
    assert onto_peak[0] - flat[0] == pytest.approx(4 * height**2 * area / 3.0, rel=0.5)


def test_seams_straighten_only_where_they_are_straight():
    """A seam with a tooth in a flat textured plane: the tooth's tip costs more than vertices on the straight part."""
    mesh = plane(8, 8)
    centers = mesh.vertices[mesh.triangles].mean(axis=1)
    tooth = (centers[:, 1] < 5.0) & (np.abs(centers[:, 0] - 4.0) < 1.0)
    uvs = mesh.corner_uvs + ((centers[:, 1] < 4.0) | tooth)[:, None, None]
    mesh = build_textured_mesh(TriangleMesh(mesh.vertices, mesh.triangles), uvs)
    straight, tip = (rate(mesh, center_of(mesh, *at))[1].min() for at in ((1.0, 4.0), (5.0, 5.0)))
    assert tip > 100.0 * straight


def test_quadrics_keep_the_shape_better_than_a_random_order():
    mesh = torus(islands=4)
    targets = [len(mesh.triangles) // 10]
    chosen = TexmeshSettings(protected_fraction=0.0)
    priorities = np.random.default_rng(0).uniform(size=len(mesh.vertices))
    distances = []
    for steps in (simplify_by_cost(mesh, None, targets, chosen), simplify_in_order(mesh, priorities, targets, chosen)):
        level = run_to_end(steps).levels[0]
        distances.append(closest_on_mesh(mesh.vertices, mesh.vertices[level.triangles])[0].mean())
    assert distances[0] < 0.6 * distances[1]


class HeightCost:
    """Collapses cost the height of the removed vertex; onto lower vertices, there is none."""

    def __init__(self, mesh: TexturedMesh) -> None:
        self.heights, self.merged = mesh.vertices[:, 2], 0

    def evaluate(self, collapses: Collapses, _moves: WedgeMoves) -> np.ndarray:
        is_allowed = self.heights[collapses.kept] > self.heights[collapses.removed]
        return np.where(is_allowed, self.heights[collapses.removed] + 10.0, np.inf)

    def merge(self, collapses: Collapses, _moves: WedgeMoves) -> None:
        self.merged += len(collapses.removed)

    def drop_wedges(self, wedges: np.ndarray, vertices: np.ndarray) -> None:
        """No other cost depends on them."""


def test_a_given_cost_decides_about_order_and_direction():
    mesh = torus(islands=1)
    cost = HeightCost(mesh)
    chosen = TexmeshSettings(drastic_simplification=False)
    result = run_to_end(simplify_by_cost(mesh, lambda *_: cost, [len(mesh.triangles) * 3 // 4], chosen))
    heights = mesh.vertices[:, 2]
    assert cost.merged == len(result.removed) and result.levels[0].constraint == ""
    assert (heights[result.kept] > heights[result.removed]).all()
    assert heights[result.removed].mean() < np.quantile(heights, 0.3)
