"""Equal parts and UV islands share their place in the map, and nothing else does."""

import numpy as np
import pytest

from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.core.unwrap.stacking import find_copies
from farfield.addon.core.unwrap.unwrapping import unwrap
from shapes import box, bumpy_sphere, sheet

pytestmark = pytest.mark.usefixtures("coarse_packing")


def rotation(seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.linalg.det(q)


def shuffled(mesh: TriangleMesh, seed: int) -> TriangleMesh:
    """The same surface with vertices, triangles and their first corners in another order."""
    random = np.random.default_rng(seed)
    order = random.permutation(len(mesh.vertices))
    triangles = np.argsort(order)[mesh.triangles][random.permutation(len(mesh.triangles))]
    starts = random.integers(3, size=(len(triangles), 1))
    return TriangleMesh(mesh.vertices[order], triangles[np.arange(len(triangles))[:, None], (np.arange(3) + starts) % 3].astype(np.int32))


def moved(mesh: TriangleMesh, seed: int) -> TriangleMesh:
    return TriangleMesh(mesh.vertices @ rotation(seed).T + np.random.default_rng(seed).normal(size=3) * 10.0, mesh.triangles)


def find(*meshes: TriangleMesh, density: list | None = None):
    counts = [len(mesh.triangles) for mesh in meshes]
    labels = np.repeat(np.arange(len(meshes)), counts)
    mesh = concatenate(list(meshes))
    densities = np.ones(len(labels)) if density is None else np.repeat(density, counts)
    return mesh, labels, run_to_end(find_copies(mesh.corners, labels, densities, np.arange(len(labels))))


def unwrap_stacked(mesh: TriangleMesh, **settings):
    count = len(mesh.triangles)
    return run_to_end(
        unwrap(mesh, np.arange(count), np.zeros((0, 2), int), np.zeros(count), UnwrapSettings(stack_equal_islands=True, **settings))
    )


def test_a_moved_and_renumbered_copy_is_found_with_its_corners():
    original = bumpy_sphere(8)
    mesh, labels, copies = find(original, moved(shuffled(original, 1), 2))
    assert (copies.is_copy == (labels == 1)).all()
    edges = np.linalg.norm(np.roll(mesh.corners, -1, axis=1) - mesh.corners, axis=2)
    turned = edges[copies.sources[:, None], (np.arange(3) + copies.turns[:, None]) % 3]
    np.testing.assert_allclose(turned, edges, rtol=1e-6)
    assert len(np.unique(copies.sources[labels == 1])) == len(original.triangles)


@pytest.mark.parametrize(
    "change",
    [
        lambda mesh: TriangleMesh(mesh.vertices * [-1.0, 1.0, 1.0], mesh.triangles[:, ::-1]),
        lambda mesh: TriangleMesh(mesh.vertices * 1.05, mesh.triangles),
        lambda mesh: TriangleMesh(mesh.vertices + np.eye(len(mesh.vertices), 3) * 0.05, mesh.triangles),
        lambda mesh: TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1]),
    ],
    ids=["mirrored", "scaled", "one vertex moved", "inside out"],
)
def test_other_shapes_are_no_copies(change):
    original = bumpy_sphere(8)
    assert not find(original, change(original))[2].is_copy.any()


def test_parts_with_another_density_are_no_copies():
    original = box(cuts=1)
    assert not find(original, original, density=[1.0, 2.0])[2].is_copy.any()
    assert find(original, original, density=[2.0, 2.0])[2].is_copy.sum() == len(original.triangles)


def test_a_copy_with_larger_polygons_is_no_copy():
    """The original may be cut where the copy must not."""
    original = sheet(2)
    mesh, count = concatenate([original, moved(original, 3)]), len(original.triangles)
    labels, ones = np.repeat([0, 1], count), np.ones(2 * count)
    for first, second, is_found in ((1, 2, False), (2, 1, True), (2, 2, True)):
        polygon_ids = np.concatenate([np.arange(count) // first, 100 + np.arange(count) // second])
        assert run_to_end(find_copies(mesh.corners, labels, ones, polygon_ids)).is_copy.any() == is_found


def test_both_sides_of_a_card_are_matched_to_the_right_side():
    front = sheet(3)
    card = concatenate([front, TriangleMesh(front.vertices, front.triangles[:, ::-1])])
    _, labels, copies = find(card, moved(card, 5))
    count = len(front.triangles)
    assert copies.is_copy.sum() == 2 * count
    assert ((copies.sources[labels == 1] < count) == (np.arange(2 * count) < count)).all()


def test_equal_parts_have_the_same_texels():
    part, other = box((1.0, 2.0, 3.0), cuts=2), box((1.0, 1.0, 1.0), cuts=2)
    mesh = concatenate([part, other, moved(part, 3), moved(shuffled(part, 4), 4)])
    result, single = unwrap_stacked(mesh), unwrap_stacked(concatenate([part, other]))
    assert result.chart_count - result.stacked_count == single.chart_count - single.stacked_count
    assert result.stacked_count > single.stacked_count
    assert result.metrics.overlaps == result.metrics.flips == 0
    assert result.metrics.symmetric_dirichlet == pytest.approx(4.0)
    assert result.metrics.fill == pytest.approx(single.metrics.fill)
    count = len(part.triangles)
    assert np.array_equal(result.corner_uvs[:count], result.corner_uvs[count + len(other.triangles) :][:count])


def test_equal_islands_of_one_part_are_stacked():
    """The faces of a cube, for xatlas, and the strips to which they are joined otherwise."""
    strips, faces = unwrap_stacked(box(cuts=2)), unwrap_stacked(box(cuts=2), islands="atlas")
    assert (strips.chart_count, strips.stacked_count) == (4, 2) and (faces.chart_count, faces.stacked_count) == (6, 5)
    assert strips.metrics.overlaps == faces.metrics.overlaps == 0 and faces.metrics.fill > 0.95


@pytest.mark.slow
def test_nothing_is_stacked_unless_asked_for():
    mesh = concatenate([box(cuts=1), TriangleMesh(box(cuts=1).vertices + 3.0, box(cuts=1).triangles)])
    count = len(mesh.triangles)
    result = run_to_end(unwrap(mesh, np.arange(count), np.zeros((0, 2), int), np.zeros(count), UnwrapSettings()))
    assert result.stacked_count == 0 and result.metrics.overlaps == 0


def test_parts_with_other_seams_are_not_stacked():
    part = sheet(2)
    mesh = concatenate([part, moved(part, 3)])
    seam = mesh.triangles[0][[0, 1]], mesh.triangles[0][[1, 2]], mesh.triangles[0][[2, 0]]
    count = len(mesh.triangles)
    result = run_to_end(unwrap(mesh, np.arange(count), np.array(seam), np.zeros(count), UnwrapSettings(stack_equal_islands=True)))
    assert result.metrics.overlaps == 0 and result.chart_count == 3
