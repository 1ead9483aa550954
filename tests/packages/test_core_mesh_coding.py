"""Levels of meshes as bytes: what is decoded is what was encoded, and coarse levels are the beginning of fine ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from packed_meshes import SECTIONS, make_random_mesh, order_with_levels, pack, read_section, replace_section
from reference.mesh_decoding import decode_level, dequantize

from farfield.addon.core.errors import FileError, GeometryError
from farfield.addon.core.packages.mesh.coding import encode_mesh, quantize
from farfield.addon.core.packages.mesh.order import order_mesh
from farfield.addon.core.packages.mesh.traversal import find_opposite_halfedges, traverse
from farfield.addon.core.texmesh.simplification.levels import Simplification, SubsetLevel
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh
from textured_models import cube, plane, torus

MODELS = {"torus": torus(has_materials=True), "cube": cube(), "plane": plane(12, 9)}


@pytest.fixture(scope="module")
def small() -> tuple:
    """The bytes of a small mesh, and its manifest."""
    return pack(order_with_levels(torus(16, 12, 4, has_materials=True))[1])


def fine_level(mesh: TexturedMesh) -> SubsetLevel:
    return SubsetLevel(mesh.triangles, mesh.wedge_triangles, mesh.materials, 0, "", (), None)


def sort_triangles(corners: np.ndarray, materials: np.ndarray) -> np.ndarray:
    """Return rows of the corner values (T, 3, C) and materials, each with its smallest corner first, in ascending order."""
    rows = []
    for triangle, material in zip(corners.tolist(), materials.tolist(), strict=True):
        turned = min(triangle[first:] + triangle[:first] for first in range(3))
        rows.append([material, *turned[0], *turned[1], *turned[2]])
    return np.array(sorted(rows))


def corner_values(positions: np.ndarray, wedge_vertices: np.ndarray, uvs: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    return np.concatenate([positions[wedge_vertices[triangles]], uvs[triangles]], axis=2).astype(int)


def check_round_trip(mesh: TexturedMesh) -> None:
    """Check that each decoded level has the triangles, orientations, seams and materials of the subset level."""
    result, ordered = order_with_levels(mesh)
    content, manifest = pack(ordered)
    positions = quantize(mesh.vertices, manifest.bounds)
    uvs = quantize(mesh.uvs * [1.0, -1.0] + [0.0, 1.0], manifest.uv_bounds)
    subsets = [*(level for level in result.levels[::-1] if len(level.triangles)), fine_level(mesh)]
    for index, subset in enumerate(subsets):
        decoded = decode_level(content, manifest, index)
        expected = corner_values(positions, mesh.wedge_vertices, uvs, subset.wedge_triangles)
        found = corner_values(decoded.positions, decoded.wedge_vertices, decoded.uvs, decoded.triangles)
        np.testing.assert_array_equal(sort_triangles(found, decoded.materials), sort_triangles(expected, subset.materials))
        np.testing.assert_array_equal(decoded.materials, np.sort(decoded.materials))
        np.testing.assert_array_equal(decoded.parents, ordered.parents[: len(decoded.parents)])
        np.testing.assert_array_equal(decoded.wedge_vertices, ordered.wedge_vertices[: len(decoded.uvs)])
        assert len(decoded.positions) == manifest.levels[index].vertex_count


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_decoded_levels_are_the_encoded_ones(name):
    check_round_trip(MODELS[name])


@pytest.mark.slow
@given(st.integers(0, 10**6))
@settings(max_examples=12)
def test_any_triangles_survive(seed):
    check_round_trip(make_random_mesh(seed))


@pytest.mark.parametrize("name", MODELS)
def test_coarse_vertices_come_first_and_are_parents(name):
    mesh = MODELS[name]
    result, ordered = order_with_levels(mesh)
    known = 0
    for level, subset in zip(ordered.levels, result.levels[::-1], strict=False):
        assert set(np.unique(subset.triangles)) == set(ordered.vertices[: level.vertex_count])
        assert (ordered.parents[known : level.vertex_count] < known).all()
        known = level.vertex_count
    assert (ordered.parents[: ordered.levels[0].vertex_count] == -1).all()
    assert (ordered.parents[ordered.levels[0].vertex_count :] >= 0).all()


def test_moving_vertices_to_their_parents_gives_the_coarser_level():
    mesh = torus()
    _, ordered = order_with_levels(mesh)
    for coarse, fine in zip(ordered.levels[:-1], ordered.levels[1:], strict=True):
        vertices = np.arange(fine.vertex_count)
        vertices[coarse.vertex_count :] = ordered.parents[coarse.vertex_count : fine.vertex_count]
        triangles = vertices[ordered.wedge_vertices[fine.triangles]]
        triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
        expected = ordered.wedge_vertices[coarse.triangles]
        no_material = np.zeros(len(expected), int)
        np.testing.assert_array_equal(
            sort_triangles(triangles[..., None], no_material[: len(triangles)]), sort_triangles(expected[..., None], no_material)
        )


def test_wedges_that_differ_in_attributes_only_are_one():
    mesh = plane(3, 3)
    doubled = TexturedMesh(**vars(mesh) | {"attributes": np.zeros((2 * len(mesh.uvs), 1), np.float32)})
    triangles = mesh.wedge_triangles.copy()
    triangles[::2] += len(mesh.uvs)
    doubled = TexturedMesh(
        **vars(doubled)
        | {"wedge_triangles": triangles, "uvs": np.tile(mesh.uvs, (2, 1)), "wedge_vertices": np.tile(mesh.wedge_vertices, 2)},
    )
    nothing = np.zeros(0, np.int32)
    ordered = order_mesh(doubled, [], Simplification((), nothing, nothing, np.zeros(0)))
    assert len(ordered.uvs) == len(mesh.uvs)


def test_a_level_may_add_nothing():
    mesh = plane(3, 3)
    nothing = np.zeros(0, np.int32)
    same = [fine_level(mesh), fine_level(mesh)]
    ordered = order_mesh(mesh, same, Simplification(tuple(same), nothing, nothing, np.zeros(0)))
    content, manifest = pack(ordered, 1)
    levels = [decode_level(content, manifest, index) for index in range(3)]
    for level in levels[1:]:
        np.testing.assert_array_equal(level.positions, levels[0].positions)
        assert len(level.triangles) == len(mesh.triangles)


def test_levels_without_triangles_are_refused():
    mesh = plane(3, 3)
    nothing = np.zeros(0, np.int32)
    empty = SubsetLevel(np.zeros((0, 3), np.int32), np.zeros((0, 3), np.int32), nothing, 0, "", (), None)
    with pytest.raises(GeometryError, match="no triangles"):
        order_mesh(mesh, [empty], Simplification((empty,), nothing, nothing, np.zeros(0)))


def test_a_traversal_visits_each_triangle_once_and_mostly_along_the_border():
    mesh = torus(has_materials=True)
    traversal = traverse(mesh.triangles, mesh.materials)
    np.testing.assert_array_equal(np.sort(traversal.first_corners // 3), np.arange(len(mesh.triangles)))
    assert (np.diff(mesh.materials[traversal.first_corners // 3]) >= 0).all()
    attached = traversal.across >= 0
    starts, next_corners = traversal.first_corners, traversal.first_corners // 3 * 3 + (traversal.first_corners + 1) % 3
    inner_ends = traversal.across // 3 * 3 + (traversal.across + 1) % 3
    corners = mesh.triangles.ravel()
    np.testing.assert_array_equal(corners[starts[attached]], corners[inner_ends[attached]])
    np.testing.assert_array_equal(corners[next_corners[attached]], corners[traversal.across[attached]])
    assert np.count_nonzero(~attached) < 20


def test_opposite_halfedges_are_pairs_of_one_material():
    mesh = make_random_mesh(3)
    opposite = find_opposite_halfedges(mesh.triangles, mesh.materials)
    paired = np.flatnonzero(opposite >= 0)
    np.testing.assert_array_equal(opposite[opposite[paired]], paired)
    starts, ends = mesh.triangles.ravel(), np.roll(mesh.triangles, -1, axis=1).ravel()
    np.testing.assert_array_equal(starts[paired], ends[opposite[paired]])
    np.testing.assert_array_equal(ends[paired], starts[opposite[paired]])
    np.testing.assert_array_equal(mesh.materials[paired // 3], mesh.materials[opposite[paired] // 3])


def test_quantized_values_are_within_half_a_step():
    values = np.random.default_rng(0).normal(size=(100, 3)) * [1.0, 100.0, 0.0]
    bounds = (tuple(values.min(axis=0)), tuple(values.max(axis=0)))
    error = np.abs(dequantize(quantize(values, bounds), bounds) - values)
    assert (error <= 0.5001 * np.ptp(values, axis=0) / 65535 + 1e-5).all()


@pytest.mark.parametrize("name", MODELS)
def test_estimated_positions_are_nearer_than_parents(name):
    _, ordered = order_with_levels(MODELS[name])
    content, manifest = pack(ordered)
    last = len(manifest.levels) - 1
    exact, estimated = decode_level(content, manifest, last), decode_level(content, manifest, last, (last,))
    known = manifest.levels[last - 1].vertex_count
    np.testing.assert_array_equal(estimated.positions[:known], exact.positions[:known])
    np.testing.assert_array_equal(estimated.triangles, exact.triangles)
    true = exact.positions.astype(float)
    error = np.linalg.norm(estimated.positions[known:] - true[known:], axis=1).mean()
    parent_error = np.linalg.norm(true[exact.parents[known:]] - true[known:], axis=1).mean()
    assert error < 0.6 * parent_error


@given(st.data())
@settings(max_examples=50)
def test_changed_sections_are_refused_or_give_a_mesh(small, data):
    """With right checksums, so that the decoder sees them."""
    content, manifest = small
    level, name = data.draw(st.integers(0, len(manifest.levels) - 1)), data.draw(st.sampled_from(SECTIONS))
    part = bytearray(read_section(content, manifest, level, name))
    for _ in range(data.draw(st.integers(1, 3))):
        if part:
            index = data.draw(st.integers(0, len(part) - 1))
            replacement = data.draw(st.binary(max_size=2))
            part[index : index + 1] = replacement
    changed, manifest = replace_section(content, manifest, level, name, bytes(part))
    try:
        decoded = decode_level(changed, manifest, len(manifest.levels) - 1)
    except FileError:
        return
    assert decoded.triangles.min() >= 0 and decoded.triangles.max() < len(decoded.uvs)
    assert decoded.wedge_vertices.min() >= 0 and decoded.wedge_vertices.max() < len(decoded.positions)
    assert decoded.parents.max() < len(decoded.positions)


@pytest.mark.parametrize("name", SECTIONS)
def test_flipped_bits_and_missing_bytes_are_found(small, name):
    content, manifest = small
    section = getattr(manifest.levels[1], name)
    flipped = bytearray(content)
    flipped[section.offset] ^= 4
    for damaged in (bytes(flipped), content[: section.end - 1]):
        with pytest.raises(FileError, match="damaged"):
            decode_level(damaged, manifest, len(manifest.levels) - 1)


@pytest.mark.parametrize("name", SECTIONS)
def test_sections_that_expand_too_far_are_refused(small, name):
    content, manifest = small
    changed, manifest = replace_section(content, manifest, 0, name, bytes(10**6))
    with pytest.raises(FileError):
        decode_level(changed, manifest, 0)


@pytest.mark.parametrize(
    "change", [{"vertex_count": 2**40}, {"wedge_count": 2**40}, {"triangle_counts": (2**40, 0, 0)}, {"vertex_count": 3}]
)
def test_counts_that_lie_are_refused_before_anything_is_allocated(small, change):
    content, manifest = small
    level = type(manifest.levels[0])(**vars(manifest.levels[0]) | change)
    lying = type(manifest)(levels=(level, *manifest.levels[1:]), bounds=manifest.bounds, uv_bounds=manifest.uv_bounds)
    for missing in ((), (0,)):
        with pytest.raises(FileError):
            decode_level(content, lying, 0, missing)


def test_the_same_mesh_gives_the_same_bytes(small):
    _, ordered = order_with_levels(torus(16, 12, 4, has_materials=True))
    assert encode_mesh(ordered, (0.0,) * len(ordered.levels), 3)[0] == small[0]
