"""Surfaces of voxels: closed manifolds whatever the voxels, vertices where densities are 0, the same out of any part of a volume."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from closed import open_edges, uses_of_directed_edges
from farfield.addon.core.clipbox.patterns import HIGH, LOW, OCTANTS, octants_about, patterns
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
