"""Surface extraction: closed manifolds for any voxels, vertices at zero density, and the same vertices from any part of a volume."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.clipbox.meshing.case_table import HIGH, LOW, OCTANTS, case_table, edge_octants
from farfield.addon.core.clipbox.meshing.surface_nets import repair_voxels
from farfield.addon.core.clipbox.meshing.triangulation import vertex_neighbors
from surface_extraction import extract_surface
from watertight import directed_edge_counts, open_edges

SEEDS = st.integers(0, 2**32 - 1)


def random_volume(seed, shape=(8, 7, 6)):
    """Noise with an empty outermost layer."""
    random = np.random.default_rng(seed)
    volume = np.full(shape, -1.0, np.float32)
    volume[1:-1, 1:-1, 1:-1] = random.normal(size=np.subtract(shape, 2)) + random.uniform(-1.0, 1.0)
    return volume


class TestCaseTable:
    """The table of the 256 cases."""

    def test_cycles_contain_exactly_the_pairs_that_differ(self):
        table = case_table()
        for case in range(256):
            solid = np.array([bool(case >> octant & 1) for octant in range(8)])
            assert np.array_equal(table.cycles[case] >= 0, solid[LOW] != solid[HIGH])
            assert set(table.cycles[case]) - {-1} == set(range(table.cycle_counts[case]))

    def test_cycles_have_three_to_seven_faces(self):
        for row in case_table().cycles:
            face_counts = np.bincount(row[row >= 0])
            assert ((face_counts >= 3) & (face_counts <= 7)).all()

    def test_non_manifold_edges_have_a_unique_direction_and_are_resolved_by_flipping(self):
        table = case_table()
        for case in np.flatnonzero(table.non_manifold >= 0):
            alternating = [
                direction
                for direction in range(6)
                if len({case >> octant & 1 for octant in edge_octants(direction)[::2]}) == 1
                and len({case >> octant & 1 for octant in edge_octants(direction)[1::2]}) == 1
                and (case >> edge_octants(direction)[0] & 1) != (case >> edge_octants(direction)[1] & 1)
            ]
            assert alternating == [table.non_manifold[case]]
            assert table.cycle_counts[256 + case] == table.cycle_counts[case] + 1

    def test_edge_octants_lie_on_the_side_of_their_direction(self):
        for direction in range(6):
            axis, high = divmod(direction, 2)
            assert (OCTANTS[edge_octants(direction), axis] == high).all()


class TestSurface:
    """Surfaces of whole volumes."""

    @given(SEEDS)
    def test_surfaces_are_closed_manifolds(self, seed):
        surface = extract_surface(random_volume(seed))
        assert len(open_edges(surface.quads)) == 0
        assert (directed_edge_counts(surface.quads) == 1).all()

    @given(SEEDS)
    def test_each_face_separates_a_solid_from_an_empty_voxel(self, seed):
        volume = random_volume(seed)
        surface = extract_surface(volume, blocky=True)
        expected_count = sum((np.diff(volume > 0, axis=axis) != 0).sum() for axis in range(3))
        assert len(surface.quads) == expected_count
        corners = surface.vertices[surface.quads]
        centers = corners.mean(axis=1)
        normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) / 2.0
        assert np.allclose(np.abs(normals).sum(axis=1), 1.0)
        inside, outside = (np.floor(centers + 0.5 * sign * normals).astype(int) for sign in (-1, 1))
        assert (volume[tuple(inside.T)] > 0).all() and (volume[tuple(outside.T)] <= 0).all()

    @given(SEEDS)
    def test_smooth_and_blocky_surfaces_have_the_same_topology(self, seed):
        volume = random_volume(seed)
        smooth, blocky = extract_surface(volume), extract_surface(volume, blocky=True)
        assert np.array_equal(smooth.quads, blocky.quads) and np.array_equal(smooth.corners, blocky.corners)
        assert np.abs(smooth.vertices - blocky.vertices).max(initial=0.0) <= 0.5
        assert np.array_equal(blocky.vertices, blocky.corners)

    @given(SEEDS)
    def test_vertices_of_a_part_equal_those_of_the_full_volume(self, seed):
        volume = random_volume(seed, (9, 9, 9))
        full, part = extract_surface(volume), extract_surface(volume[2:7, 1:8, 3:9])
        positions = {tuple(corner): vertex for corner, vertex in zip(full.corners.tolist(), full.vertices, strict=True)}
        unique, counts = np.unique(full.corners, axis=0, return_counts=True)
        single = {tuple(corner) for corner in unique[counts == 1].tolist()}
        for corner, vertex in zip((part.corners + [2, 1, 3]).tolist(), part.vertices + [2, 1, 3], strict=True):
            if tuple(corner) in single and all(low < index < high for low, index, high in zip((2, 1, 3), corner, (7, 8, 9), strict=True)):
                assert np.array_equal(vertex, positions[tuple(corner)])

    @pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
    def test_a_sphere_is_round(self, dtype):
        centers = np.stack(np.meshgrid(*[np.arange(24) + 0.5 - 12.0] * 3, indexing="ij"), axis=-1)
        surface = extract_surface((8.0 - np.linalg.norm(centers, axis=-1)).astype(dtype))
        radii = np.linalg.norm(surface.vertices - 12.0, axis=1)
        assert radii.min() > 7.85 and radii.max() < 8.05
        corners = surface.vertices[surface.quads]
        volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])).sum() / 6.0
        volume += np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 0])).sum() / 6.0
        assert volume == pytest.approx(4.0 / 3.0 * np.pi * 8.0**3, rel=0.02)
        normals = (surface.vertices - 12.0) / radii[:, None]
        assert (np.einsum("vi,vi->v", normals, surface.normals) > 0.98).all()

    def test_a_plane_lies_at_zero_density(self):
        densities = np.broadcast_to(3.3 - (np.arange(8) + 0.5), (6, 6, 8)).astype(np.float32)
        surface = extract_surface(densities)
        assert np.allclose(surface.vertices[:, 2], 3.3, atol=1e-6) and np.allclose(surface.normals, [0.0, 0.0, 1.0])

    @pytest.mark.parametrize("value", [-1.0, 1.0])
    def test_uniform_volumes_have_no_surface(self, value):
        assert len(extract_surface(np.full((4, 5, 6), value, np.float32)).quads) == 0


@given(SEEDS)
def test_neighbors_are_the_vertices_along_edges(seed):
    surface = extract_surface(random_volume(seed), blocky=True)
    neighbors = vertex_neighbors(surface.quads, len(surface.vertices))
    for vertex in range(0, len(surface.vertices), 7):
        ends = neighbors[vertex][neighbors[vertex] >= 0]
        assert len(ends) == (surface.quads == vertex).any(axis=1).sum()
        assert (np.abs(surface.vertices[ends] - surface.vertices[vertex]).sum(axis=1) == 1.0).all()


class TestRepair:
    """Repair of voxels that would smooth badly."""

    @staticmethod
    def repair(*voxels):
        volume = np.zeros((7, 7, 7), bool)
        volume[tuple(np.array(voxels).T)] = True
        return {tuple(voxel) for voxel in (np.argwhere(repair_voxels(volume)) + 1).tolist()}

    def test_single_voxels_and_tips_of_spikes_are_removed(self):
        assert self.repair((3, 3, 3)) == set()
        slab = [(x, y, 2) for x in (2, 3, 4) for y in (2, 3, 4)]
        assert self.repair(*slab, (3, 3, 3)) == set(slab)

    def test_pits_are_filled(self):
        walls = [(x, y, z) for x in (2, 3, 4) for y in (2, 3, 4) for z in (2, 3) if (x, y, z) != (3, 3, 3)]
        assert (3, 3, 3) in self.repair(*walls)

    def test_voxels_that_touch_along_an_edge_are_joined(self):
        blocks = [(x, y, z) for x, y in ((2, 2), (1, 2), (2, 1), (1, 1), (3, 3), (4, 3), (3, 4), (4, 4)) for z in (2, 3, 4)]
        repaired = self.repair(*blocks)
        assert len({(2, 3, 3), (3, 2, 3)} & repaired) == 1 and set(blocks) <= repaired

    @given(SEEDS)
    def test_parts_are_repaired_like_the_full_volume(self, seed):
        volume = np.random.default_rng(seed).random((8, 9, 7)) < 0.5
        assert np.array_equal(repair_voxels(volume)[1:5, 2:6, 0:4], repair_voxels(volume[1:7, 2:8, 0:6]))

    def test_smooth_shapes_are_kept(self):
        x, y, z = np.indices((20, 20, 20))
        ball = (x - 9.5) ** 2 + (y - 9.5) ** 2 + (z - 9.5) ** 2 < 49.0
        assert (repair_voxels(ball) != ball[1:-1, 1:-1, 1:-1]).mean() < 0.002
