"""Pages of a texture: tiles and groups are found, and a page holds what it would hold alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.merging import merge
from farfield.addon.core.photos.photographs.surface import Surface
from farfield.addon.core.photos.settings import PhotosSettings
from farfield.addon.core.photos.texels.hole_filling import HoleFiller
from farfield.addon.core.photos.texels.pages import MAX_PAGES, NO_PAGE, find_overlapping, lay_out_pages
from farfield.addon.core.photos.texels.texel_map import TexelMap
from photo_scenes import SIZE, camera_at, grid, photograph, ring, smooth_texture

pytestmark = pytest.mark.usefixtures("quick_merges")


def two_islands():
    """The wavy square, its left half as an island in the left half of the texture, its right half in the right half, with a gap."""
    mesh, uvs = grid(12, lambda x, y: 0.1 * np.sin(2 * x) * np.cos(3 * y))
    is_right = uvs.mean(axis=1)[:, 0] > 0.5
    separated = uvs * np.float32([0.75, 0.9]) + np.float32([0.03, 0.05])
    separated[is_right, :, 0] += np.float32(0.19)
    return mesh, uvs, separated, is_right


def own_texels(uvs, triangles):
    """The texels (SIZE, SIZE) bool that some triangles cover."""
    return (TexelMap(uvs[triangles], SIZE).triangles >= 0).reshape(SIZE, SIZE)


class TestLayout:
    """Which triangle is on which page."""

    @given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 99), st.integers(0, 2)), min_size=1, max_size=30))
    def test_each_used_tile_of_a_group_is_a_page(self, places):
        columns, rows, groups = np.array(places).T
        corner = np.array([[0.2, 0.2], [0.8, 0.2], [0.2, 0.8]])
        uvs = (corner + np.stack([columns, rows], axis=1)[:, None]).astype(np.float32)
        layout = lay_out_pages(uvs, groups)
        found = [(layout.groups[page], layout.tiles[page]) for page in layout.pages]
        assert found == [(group, 1001 + column + 10 * row) for column, row, group in places]
        assert sorted(set(found)) == list(zip(layout.groups, layout.tiles, strict=True))
        assert layout.corner_uvs == pytest.approx(np.broadcast_to(corner, uvs.shape), abs=1e-4)
        for group in set(groups.tolist()):
            assert all(layout.groups[page] == group and layout.tiles[page] == tile for tile, page in layout.find_tiles(group).items())

    def test_a_square_from_0_to_1_stays_as_it_is(self):
        _, uvs = grid(7)
        layout = lay_out_pages(uvs)
        assert not layout.is_tiled and layout.tiles == (1001,) and np.array_equal(layout.corner_uvs, uvs) and not layout.pages.any()

    @pytest.mark.parametrize("cell", [(0, 1), (3, 0), (-1, 0), (0, -2), (12, 0)])
    def test_uvs_in_one_other_square_are_moved_as_images_repeat(self, cell):
        """Only those in a tile stay there, where tiles are asked for; each group by itself."""
        _, uvs = grid(7)
        moved, is_tile = uvs + np.array(cell, np.float32), min(cell) >= 0 and cell[0] < 10
        layout = lay_out_pages(moved, keeps_tiles=False)
        assert layout.tiles == (1001,) and layout.corner_uvs == pytest.approx(uvs, abs=1e-5)
        assert lay_out_pages(moved).tiles == ((1001 + cell[0] + 10 * cell[1],) if is_tile else (1001,))
        groups = np.repeat([0, 1], len(uvs))
        both = lay_out_pages(np.concatenate([uvs, moved]), groups, keeps_tiles=False)
        assert both.tiles == (1001, 1001) and both.groups == (0, 1)
        assert lay_out_pages(np.concatenate([uvs, moved]), keeps_tiles=False).is_tiled == is_tile

    def test_rounding_errors_and_what_is_outside_make_no_page(self):
        """A face at the edge, one with a negative centroid and one in the eleventh column go to the nearest tile; degenerate faces of a
        group alone are nowhere."""
        triangle = np.array([[0.1, 0.1], [0.6, 0.1], [0.1, 0.6]])
        sliver = np.array([[1.0, 0.1], [1.0, 0.6], [1.0 + 1e-7, 0.3]])
        uvs = np.stack([triangle, triangle + [9.0, 0.0], sliver, triangle - [1.0, 0.0], triangle + [10.0, 0.0], np.zeros((3, 2))])
        layout = lay_out_pages(uvs, np.array([0, 0, 0, 0, 0, 1]))
        assert layout.tiles == (1001, 1010) and layout.pages.tolist() == [0, 1, 0, 0, 1, NO_PAGE]
        covered = TexelMap(layout.corner_uvs, 64, layout.pages).triangles
        assert set(covered.tolist()) == {-1, 0, 1}

    def test_faces_that_straddle_tiles_belong_to_that_of_their_centroid(self):
        uvs = np.array([[[0.5, 0.1], [1.2, 0.1], [0.5, 0.6]], [[1.7, 0.1], [0.9, 0.9], [1.7, 0.9]]])
        layout = lay_out_pages(uvs)
        assert layout.tiles == (1001, 1002) and layout.pages.tolist() == [0, 1]
        first, second = TexelMap(layout.corner_uvs, 32, layout.pages).triangles.reshape(2, 32, 32)
        assert set(first.ravel().tolist()) == {-1, 0} and set(second.ravel().tolist()) == {-1, 1}

    def test_too_many_pages_are_one_sentence(self):
        _, uvs = grid(20)
        with pytest.raises(GeometryError, match=rf"needs 400 images.*limit is {MAX_PAGES}"):
            lay_out_pages(uvs * 20.0 * np.float32([0.5, 2.0]))


def test_islands_on_different_pages_do_not_overlap():
    _, uvs = grid(8)
    stacked = np.concatenate([uvs, uvs])
    pages = np.repeat([0, 1], len(uvs))
    assert find_overlapping(stacked).all() and not find_overlapping(stacked, pages).any()
    stacked[:10] = stacked[20:30]
    assert np.flatnonzero(find_overlapping(stacked, pages)).tolist() == [*range(10), *range(20, 30)]


class TestMerge:
    """Whole merges with two pages."""

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("method", "fill"),
        [
            ("best", "interpolate"),
            pytest.param("average", "none", marks=pytest.mark.exhaustive),
            pytest.param("paper", "restore", marks=pytest.mark.exhaustive),
        ],
    )
    def test_pages_equal_the_islands_of_one_page(self, method, fill):
        """Texel for texel, also where a photograph is masked."""
        mesh, uvs, separated, is_right = two_islands()
        photographs = [photograph(mesh, uvs, smooth_texture(), camera) for camera in ring(3)]
        for each in photographs:
            object.__setattr__(each, "mask", np.ones(each.pixels.shape[:2], bool))
            each.mask[100:150, 120:190] = False
        options = PhotosSettings(size=SIZE, method=method, fill=fill)
        expected = run_to_end(merge(mesh, separated, photographs, options))
        found = run_to_end(merge(mesh, separated, photographs, options, pages=is_right.astype(np.int32)))
        assert expected.holes.sum() > 64
        assert found.colors.shape == (2 * SIZE, SIZE, 3) and found.hole_counts == expected.hole_counts
        gains, expected_gains = ([correction.gain for correction in each.color_corrections] for each in (found, expected))
        assert np.array_equal(gains, expected_gains) and np.array_equal(found.labels, expected.labels)
        for page, chosen in enumerate((~is_right, is_right)):
            own, rows = own_texels(separated, chosen), slice(page * SIZE, (page + 1) * SIZE)
            for name in ("colors", "confidence", "source", "holes"):
                assert np.array_equal(getattr(found, name)[rows][own], getattr(expected, name)[own]), name
            assert not found.holes[rows][~own].any() and (found.source[rows][~own] == -1).all()

    def test_gutters_do_not_cross_pages(self):
        """A red square reaches up to the top of its page, and a green one down to the bottom of the page above."""
        square, uvs = grid(4)
        vertices = np.concatenate([square.vertices * 0.4 + [x, 0.0, 0.0] for x in (-0.5, 0.5)])
        mesh = TriangleMesh(vertices, np.concatenate([square.triangles, square.triangles + len(square.vertices)]).astype(np.int32))
        pages = np.repeat([0, 1], len(uvs)).astype(np.int32)
        texture = np.zeros((SIZE, SIZE, 3), np.float32)
        texture[:, : SIZE // 2], texture[:, SIZE // 2 :] = (0.8, 0.1, 0.1), (0.1, 0.8, 0.1)
        halves = np.float32([0.46, 1.0])
        painted = np.concatenate([uvs * halves, uvs * halves + np.float32([0.54, 0.0])])
        photographs = [photograph(mesh, painted, texture, camera_at((0.0, 0.0, 3.0)))]
        scaled = uvs * np.float32([1.0, 0.9])
        local = np.concatenate([scaled + np.float32([0.0, 0.1]), scaled])
        result = run_to_end(merge(mesh, local, photographs, PhotosSettings(size=SIZE), pages=pages))
        assert np.abs(result.colors[:SIZE] - [0.8, 0.1, 0.1]).max() < 0.03
        assert np.abs(result.colors[SIZE:] - [0.1, 0.8, 0.1]).max() < 0.03


@pytest.mark.slow
@settings(max_examples=4, deadline=None)
@given(st.integers(0, 1000))
def test_holes_are_filled_from_the_surface_and_not_from_the_other_page(seed):
    """Texels of other pages at the same place, and above and below, have a color that must not appear."""
    mesh, uvs = grid(10)
    centers = uvs.mean(axis=1)
    pages = np.where(centers[:, 1] > 0.5, 1, 0).astype(np.int32)
    local = uvs.copy()
    local[:, :, 1] = 2.0 * local[:, :, 1] - pages[:, None]
    texel_map = TexelMap(local, 64, pages)
    colors, found = np.full((2 * 64 * 64, 3), 0.9, np.float32), np.zeros(2 * 64 * 64, bool)
    hole = np.random.default_rng(seed).uniform(-0.6, 0.6, 2)
    for tile in texel_map.tiles():
        points = tile.interpolate(mesh.corners)
        colors[tile.texels] = np.where(points[:, 1:2] > 0.0, np.float32(0.3), np.float32(0.1))
        found[tile.texels] = np.hypot(*(points[:, :2] - hole).T) > 0.3
    colors[~found] = 0.9
    counts = run_to_end(HoleFiller(Surface.around_origin(mesh), texel_map, colors, found).fill())
    assert counts.restored == counts.found > 0
    assert colors[texel_map.triangles >= 0].max() < 0.31


def test_a_surface_on_no_page_is_one_sentence():
    mesh, uvs = grid(3)
    photographs = [photograph(mesh, uvs, smooth_texture(), camera_at((0.0, 0.0, 3.0)))]
    nowhere = np.full(len(uvs), NO_PAGE, np.int32)
    with pytest.raises(GeometryError, match="covers no pixel"):
        run_to_end(merge(TriangleMesh(mesh.vertices, mesh.triangles), uvs, photographs, PhotosSettings(size=SIZE), pages=nowhere))
    with pytest.raises(GeometryError, match="choose a smaller Size"):
        run_to_end(merge(mesh, uvs, photographs, PhotosSettings(size=32768), pages=np.arange(len(uvs), dtype=np.int32)))
