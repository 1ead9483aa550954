"""Tests of the levels: each is the best cloud of its error and clearly lighter than the one before; nested ones are a choice."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from farfield.addon.core.billboards.build import build_cloud
from farfield.addon.core.billboards.cloud import Cloud
from farfield.addon.core.billboards.lightness import describe_weight, keep_lighter_levels, limit_triangles
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate
from farfield.addon.core.jobs.progress import Progress, run_to_end
from shapes import box, bumpy_sphere, cylinder, leaf_cards, sheet, sphere

EXHAUSTIVE = pytest.mark.exhaustive
MESHES = {
    "bumpy": bumpy_sphere(6),
    "leaves": leaf_cards(80, size=0.05),
    "tree": concatenate([cylinder(radius=0.1, sides=12, cuts=4), leaf_cards(40)]),
}


@pytest.fixture(scope="module", params=[pytest.param("bumpy", marks=EXHAUSTIVE), pytest.param("leaves", marks=EXHAUSTIVE), "tree"])
def nested(request) -> tuple[TriangleMesh, Cloud]:
    """Return a mesh and its cloud of four nested levels."""
    mesh = MESHES[request.param]
    return mesh, run_to_end(build_cloud(mesh, BillboardSettings(error=0.01, levels=4, nested_levels=True)))


def test_errors_and_texel_sizes_double(nested):
    _, cloud = nested
    for index, level in enumerate(cloud.levels):
        assert level.error == pytest.approx(0.01 * cloud.longest_side * 2.0**index)
        assert level.texel_size == pytest.approx(0.5 * level.error)


def test_finer_owners_have_one_coarser_owner(nested):
    _, cloud = nested
    for finer, coarser in pairwise(cloud.levels):
        owners = np.unique(np.stack([finer.quads.owner, coarser.quads.owner], axis=1), axis=0)
        assert len(owners) == len(np.unique(finer.quads.owner))


def test_coarser_levels_are_smaller(nested):
    _, cloud = nested
    for finer, coarser in pairwise(cloud.levels):
        assert len(coarser.quads) <= len(finer.quads)
        assert coarser.texel_count < finer.texel_count


def test_every_level_shows_every_face_within_its_error(nested):
    mesh, cloud = nested
    for level in cloud.levels:
        quads = level.quads
        quad = np.repeat(np.arange(len(quads)), np.diff(quads.drawn_offsets))
        heights = np.einsum("kci,ki->kc", mesh.corners[quads.drawn] - quads.centers[quad][:, None], quads.frames[quad, 2])
        assert np.abs(heights).max() <= level.error
        np.testing.assert_array_equal(np.unique(quads.drawn), np.arange(len(mesh.triangles)))
    assert cloud.uncovered_faces == 0


def test_owners_are_existing_quads(nested):
    _, cloud = nested
    for level in cloud.levels:
        assert level.quads.owner.min() >= 0 and level.quads.owner.max() < len(level.quads)
        assert len(level.cutouts) == len(level.atlas.rectangles) == len(level.joined) == len(level.solid) == len(level.quads)


def build(mesh: TriangleMesh, **settings) -> Cloud:
    return run_to_end(build_cloud(mesh, BillboardSettings(**({"solid_parts": "quads"} | settings)), "Shape"))


@pytest.mark.slow
def test_every_level_is_the_cloud_of_its_error():
    mesh = sphere(8)
    cloud = build(mesh, error=0.06, levels=2)
    assert len(cloud.levels) > 1
    for level in cloud.levels:
        (alone,) = build(mesh, error=level.error / cloud.longest_side, levels=1).levels
        assert level.quads.centers.tobytes() == alone.quads.centers.tobytes()
        assert level.quads.owner.tobytes() == alone.quads.owner.tobytes()


@pytest.mark.parametrize("mesh", [pytest.param(MESHES[name], marks=() if name == "tree" else EXHAUSTIVE) for name in MESHES], ids=MESHES)
def test_every_level_has_clearly_fewer_triangles_or_is_left_out_with_a_sentence(mesh):
    cloud = build(mesh, error=0.01, levels=5)
    for finer, coarser in pairwise(cloud.levels):
        assert coarser.triangle_count <= 0.55 * finer.triangle_count
    left_out = [note for note in cloud.notes if "is left out" in note]
    assert len(cloud.levels) + len(left_out) == 5


def test_a_level_of_a_box_that_saves_nothing_is_left_out():
    cloud = build(box(), error=0.01, levels=2)
    assert [level.triangle_count for level in cloud.levels] == [12]
    assert cloud.notes == [
        "The level with an error of 2% is left out: it has 12 triangles, more than 0.55 times the 12 of the level before."
    ]


def test_corners_give_way_where_that_keeps_a_level():
    (level,) = build(sphere(8), error=0.05, levels=1).levels
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    hexagon = np.array([[-1.0, -1.0], [0.5, -1.0], [1.0, -0.5], [1.0, 1.0], [-0.5, 1.0], [-1.0, 0.5]])
    cut = replace(level, cutouts=[hexagon] * len(level.cutouts))
    count = len(level.cutouts)
    assert cut.triangle_count == 4 * count
    fewer = limit_triangles(cut, 3 * count)
    assert 3 * count - 2 < fewer.triangle_count <= 3 * count
    kept = [index for index, cutout in enumerate(fewer.cutouts) if len(cutout) == 6]
    assert min(level.quads.areas[kept]) >= max(np.delete(level.quads.areas, kept)), "small quads become rectangles first"
    assert all(np.array_equal(cutout, square) for index, cutout in enumerate(fewer.cutouts) if index not in kept)
    assert limit_triangles(cut, count) is cut, "two triangles a quad are the least"
    heavier = replace(cut, cutouts=[hexagon[:, [1, 0]][::-1]] * count * 4, charts=[None] * count * 4)
    assert [len(each.cutouts) for each in keep_lighter_levels([heavier, cut], 1.0)[0]] == [4 * count, count]


@pytest.mark.slow
def test_a_cloud_that_is_no_lighter_than_its_source_proposes_an_error():
    mesh = bumpy_sphere(8)
    cloud = build(mesh, error=0.01, levels=1)
    (note,) = cloud.notes
    assert note.startswith('The cloud of "Shape" has') and "its source 224: an error of about" in note
    proposed = float(note.split("about ")[1].split("%")[0]) / 100.0
    assert proposed > 0.01
    assert build(mesh, error=proposed, levels=1).levels[0].triangle_count <= 1.25 * len(mesh.triangles)
    assert "no error would make it lighter" in build(box(cuts=1), error=0.01, levels=1).notes[0]
    assert build(sphere(12), error=0.1, levels=1).notes == []


def test_a_lighter_level_is_proposed_before_an_estimate():
    levels = build(sphere(8), error=0.04, levels=2).levels
    sentence = describe_weight(levels, 2.0, levels[0].triangle_count, lambda _: 1e9, "Shape")
    assert f"an error of about {levels[1].error / 2.0:.2%}".replace(".00", "") in sentence


def test_a_corner_is_cut_only_where_it_saves_sixteen_pixels():
    """The smallest rectangle around a right triangle lies along its hypotenuse; half of it, two corners, is empty."""
    triangle = TriangleMesh(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([[0, 1, 2]], np.int32))
    assert build(triangle, error=0.01, levels=1).levels[0].triangle_count == 4
    assert build(triangle, error=0.2, levels=1).levels[0].triangle_count == 2


@pytest.mark.slow
@pytest.mark.parametrize("method", ["clusters", "hough", pytest.param("decimate", marks=pytest.mark.exhaustive)])
def test_level_does_not_depend_on_coarser_ones(method):
    mesh = box(cuts=2)
    settings = (BillboardSettings(method=method, error=0.08, levels=levels) for levels in (1, 2))
    single, first = (run_to_end(build_cloud(mesh, each)).levels[0] for each in settings)
    assert single.quads.centers.tobytes() == first.quads.centers.tobytes()
    assert single.quads.owner.tobytes() == first.quads.owner.tobytes()


def test_level_without_detail_is_one_quad():
    bumpy_sheet = sheet(8, lambda x, y: 0.04 * np.sin(9.0 * x) * np.cos(8.0 * y))
    cloud = run_to_end(build_cloud(bumpy_sheet, BillboardSettings(error=0.02, levels=3)))
    assert len(cloud.levels[-1].quads) == 1


@pytest.mark.parametrize("method", ["clusters", "hough", pytest.param("decimate", marks=pytest.mark.exhaustive)])
def test_progress_rises_from_0_to_nearly_1(method):
    steps: list[Progress] = []
    run_to_end(build_cloud(box(cuts=2), BillboardSettings(method=method, error=0.08, levels=2)), steps.append)
    fractions = [step.fraction for step in steps]
    assert all(0.0 <= fraction <= 1.0 for fraction in fractions)
    assert fractions[0] < 0.1 and fractions[-1] >= 0.95
    assert all(step.label for step in steps)
