"""Surfaces of voxels: closed manifolds whatever the voxels, vertices where densities are 0, the same out of any part of a volume."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from closed import open_edges, uses_of_directed_edges
from farfield.addon.core.clipbox.adjacency import corner_vertices, face_faces, vertex_faces, vertex_vertices
from farfield.addon.core.clipbox.patterns import HIGH, LOW, OCTANTS, octants_about, patterns
from farfield.addon.core.clipbox.repair import repaired
from farfield.addon.core.clipbox.surface import surface_of

SEEDS = st.integers(0, 2**32 - 1)


def random_volume(seed, shape=(8, 7, 6)):
    """Noise with a border that is not set."""
    random = np.random.default_rng(seed)
    volume = np.full(shape, -1.0, np.float32)
    volume[1:-1, 1:-1, 1:-1] = random.normal(size=np.subtract(shape, 2)) + random.uniform(-1.0, 1.0)
    return volume


class TestPatterns:
    """The tables of the 256 patterns."""

    def test_rings_hold_each_pair_that_differs_and_no_other(self):
        tables = patterns()
        for pattern in range(256):
            is_set = np.array([bool(pattern >> octant & 1) for octant in range(8)])
            assert np.array_equal(tables.rings[pattern] >= 0, is_set[LOW] != is_set[HIGH])
            assert set(tables.rings[pattern]) - {-1} == set(range(tables.counts[pattern]))

    def test_rings_have_three_to_seven_faces(self):
        for row in patterns().rings:
            sizes = np.bincount(row[row >= 0])
            assert ((sizes >= 3) & (sizes <= 7)).all()

    def test_what_is_pinched_is_so_in_one_direction_and_mended_there(self):
        tables = patterns()
        for pattern in np.flatnonzero(tables.pinched >= 0):
            alternating = [
                direction
                for direction in range(6)
                if len({pattern >> octant & 1 for octant in octants_about(direction)[::2]}) == 1
                and len({pattern >> octant & 1 for octant in octants_about(direction)[1::2]}) == 1
                and (pattern >> octants_about(direction)[0] & 1) != (pattern >> octants_about(direction)[1] & 1)
            ]
            assert alternating == [tables.pinched[pattern]]
            assert tables.counts[256 + pattern] == tables.counts[pattern] + 1

    def test_octants_lie_on_the_side_of_their_direction(self):
        for direction in range(6):
            axis, high = divmod(direction, 2)
            assert (OCTANTS[octants_about(direction), axis] == high).all()


class TestSurface:
    """Whole volumes."""

    @given(SEEDS)
    def test_it_is_a_closed_manifold_however_voxels_touch(self, seed):
        made = surface_of(random_volume(seed))
        assert len(open_edges(made.quads)) == 0
        assert (uses_of_directed_edges(made.quads) == 1).all()

    @given(SEEDS)
    def test_each_face_is_between_a_set_and_an_unset_voxel(self, seed):
        volume = random_volume(seed)
        made = surface_of(volume, blocky=True)
        expected = sum((np.diff(volume > 0, axis=axis) != 0).sum() for axis in range(3))
        assert len(made.quads) == expected
        corners = made.vertices[made.quads]
        centres = corners.mean(axis=1)
        outwards = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) / 2.0
        assert np.allclose(np.abs(outwards).sum(axis=1), 1.0)
        inside, outside = (np.floor(centres + 0.5 * sign * outwards).astype(int) for sign in (-1, 1))
        assert (volume[tuple(inside.T)] > 0).all() and (volume[tuple(outside.T)] <= 0).all()

    @given(SEEDS)
    def test_both_kinds_have_the_same_topology(self, seed):
        volume = random_volume(seed)
        smooth, blocky = surface_of(volume), surface_of(volume, blocky=True)
        assert np.array_equal(smooth.quads, blocky.quads) and np.array_equal(smooth.corners, blocky.corners)
        assert np.abs(smooth.vertices - blocky.vertices).max(initial=0.0) <= 0.5
        assert np.array_equal(blocky.vertices, blocky.corners)

    @given(SEEDS)
    def test_vertices_of_a_part_are_those_of_the_whole(self, seed):
        volume = random_volume(seed, (9, 9, 9))
        whole, part = surface_of(volume), surface_of(volume[2:7, 1:8, 3:9])
        places = {tuple(corner): vertex for corner, vertex in zip(whole.corners.tolist(), whole.vertices, strict=True)}
        single = {corner for corner in places if sum((whole.corners == corner).all(axis=1)) == 1}
        for corner, vertex in zip((part.corners + [2, 1, 3]).tolist(), part.vertices + [2, 1, 3], strict=True):
            if tuple(corner) in single and all(low < at < high for low, at, high in zip((2, 1, 3), corner, (7, 8, 9), strict=True)):
                assert np.array_equal(vertex, places[tuple(corner)])

    @pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
    def test_a_ball_comes_out_round(self, dtype):
        at = np.stack(np.meshgrid(*[np.arange(24) + 0.5 - 12.0] * 3, indexing="ij"), axis=-1)
        made = surface_of((8.0 - np.linalg.norm(at, axis=-1)).astype(dtype))
        radii = np.linalg.norm(made.vertices - 12.0, axis=1)
        assert radii.min() > 7.85 and radii.max() < 8.05
        corners = made.vertices[made.quads]
        volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])).sum() / 6.0
        volume += np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 0])).sum() / 6.0
        assert volume == pytest.approx(4.0 / 3.0 * np.pi * 8.0**3, rel=0.02)
        normals = (made.vertices - 12.0) / radii[:, None]
        assert (np.einsum("vi,vi->v", normals, made.normals) > 0.98).all()

    def test_a_plane_lies_where_the_density_is_zero(self):
        height = np.broadcast_to(3.3 - (np.arange(8) + 0.5), (6, 6, 8)).astype(np.float32)
        made = surface_of(height)
        assert np.allclose(made.vertices[:, 2], 3.3, atol=1e-6) and np.allclose(made.normals, [0.0, 0.0, 1.0])

    @pytest.mark.parametrize("value", [-1.0, 1.0])
    def test_without_a_border_there_is_no_surface(self, value):
        assert len(surface_of(np.full((4, 5, 6), value, np.float32)).quads) == 0


class TestAdjacency:
    """What touches what."""

    @given(SEEDS)
    def test_index_arrays_agree_with_the_quads(self, seed):
        volume = random_volume(seed)
        made = surface_of(volume, blocky=True)
        count = len(made.vertices)
        about, near, beyond = vertex_faces(made.quads, count), vertex_vertices(made.quads, count), face_faces(made.quads)
        assert (np.bincount(about[about >= 0], minlength=len(made.quads)) == 4).all()
        for vertex in range(0, count, 7):
            faces = about[vertex][about[vertex] >= 0]
            assert set(faces) == set(np.flatnonzero((made.quads == vertex).any(axis=1)))
            ends = near[vertex][near[vertex] >= 0]
            assert len(ends) == len(faces) and (np.abs(made.vertices[ends] - made.vertices[vertex]).sum(axis=1) == 1.0).all()
        assert (beyond >= 0).all()
        for turn in range(4):
            shared = made.quads[beyond[:, turn]]
            ends = made.quads[:, [turn, (turn + 1) % 4]]
            assert ((shared == ends[:, :1]).any(axis=1) & (shared == ends[:, 1:]).any(axis=1)).all()

    def test_corners_know_their_vertices(self):
        volume = random_volume(3)
        made = surface_of(volume)
        found = corner_vertices(made, volume.shape)
        assert set(found.ravel()) - {-1} <= set(range(len(made.corners)))
        assert (found[tuple(made.corners.T)] >= 0).all() and (found >= 0).sum() == len(np.unique(made.corners, axis=0))


class TestRepair:
    """Voxels that would smooth badly."""

    @staticmethod
    def mended(*places):
        volume = np.zeros((7, 7, 7), bool)
        volume[tuple(np.array(places).T)] = True
        return {tuple(each) for each in (np.argwhere(repaired(volume)) + 1).tolist()}

    def test_a_lone_voxel_and_the_tip_of_a_spike_go(self):
        assert self.mended((3, 3, 3)) == set()
        slab = [(x, y, 2) for x in (2, 3, 4) for y in (2, 3, 4)]
        assert self.mended(*slab, (3, 3, 3)) == set(slab)

    def test_a_pit_is_filled(self):
        walls = [(x, y, z) for x in (2, 3, 4) for y in (2, 3, 4) for z in (2, 3) if (x, y, z) != (3, 3, 3)]
        assert (3, 3, 3) in self.mended(*walls)

    def test_voxels_that_touch_along_an_edge_are_joined(self):
        blocks = [(x, y, z) for x, y in ((2, 2), (1, 2), (2, 1), (1, 1), (3, 3), (4, 3), (3, 4), (4, 4)) for z in (2, 3, 4)]
        made = self.mended(*blocks)
        assert len({(2, 3, 3), (3, 2, 3)} & made) == 1 and set(blocks) <= made

    @given(SEEDS)
    def test_a_part_is_mended_as_the_whole_is(self, seed):
        volume = np.random.default_rng(seed).random((8, 9, 7)) < 0.5
        assert np.array_equal(repaired(volume)[1:5, 2:6, 0:4], repaired(volume[1:7, 2:8, 0:6]))

    def test_it_leaves_what_is_smooth(self):
        x, y, z = np.indices((20, 20, 20))
        ball = (x - 9.5) ** 2 + (y - 9.5) ** 2 + (z - 9.5) ** 2 < 49.0
        assert (repaired(ball) != ball[1:-1, 1:-1, 1:-1]).mean() < 0.002
