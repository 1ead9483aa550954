"""Budgets: what is built takes no more than was asked for and comes near to it, leaves and trunk each keep to their part."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import shapes
from farfield.addon.core.billboards import primitives as primitives_module
from farfield.addon.core.billboards.budget import Budget, budget_of, kinds_of
from farfield.addon.core.billboards.build import build
from farfield.addon.core.billboards.estimate import BYTES_PER_TEXEL
from farfield.addon.core.billboards.levels import LevelBuilder
from farfield.addon.core.billboards.primitives import from_mesh
from farfield.addon.core.billboards.search import LARGEST, MOST_BUILDS, SMALLEST, Attempt, search
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.billboards.surfaces import surfaces_of
from farfield.addon.core.errors import SettingsError
from farfield.addon.core.mesh import TriangleMesh, longest_side, merge
from farfield.addon.core.progress import Progress, StageClock, finish


def cloud_of(mesh, **how):
    return finish(build(mesh, BillboardSettings(**how), "mesh"))


def tree(leaves=80):
    """A curved trunk of 384 triangles, one connected surface, under a ball of loose cards."""
    trunk = shapes.cylinder(radius=0.5, length=2.0, sides=24, cuts=8)
    bent = (
        trunk.vertices + np.column_stack([0.3 * np.sin(2.0 * trunk.vertices[:, 2]), np.zeros((len(trunk.vertices), 2))]) - [0.0, 0.0, 2.0]
    )
    return merge([TriangleMesh(bent, trunk.triangles), shapes.cards(leaves, size=0.05)])


def quads_by_kind(mesh, level):
    """How many quads of `level` show loose parts and how many show connected surfaces; none shows both."""
    loose = surfaces_of(from_mesh(mesh)).loose
    shown = [loose[part] for part in np.split(level.quads.drawn, level.quads.drawn_offsets[1:-1])]
    assert all(part.all() or not part.any() for part in shown)
    return sum(part.all() for part in shown), sum(not part.any() for part in shown)


def megabytes(cloud):
    return sum(level.atlas.size[0] * level.atlas.size[1] for level in cloud.levels) * BYTES_PER_TEXEL / 1e6


def test_both_budgets_at_once_are_refused():
    with pytest.raises(SettingsError, match="--quads 10 and --texture-mb 2"):
        cloud_of(shapes.sphere(6), quads=10, texture_mb=2.0)


def test_no_budget_is_asked_for_unless_a_number_is_given():
    assert budget_of(BillboardSettings()) is None
    assert budget_of(BillboardSettings(quads=7)).limit == 7
    assert budget_of(BillboardSettings(texture_mb=0.5)).limit == 0.5


def test_more_quads_asked_for_are_more_quads_with_smaller_errors():
    clouds = [(asked, cloud_of(shapes.sphere(10), quads=asked, levels=1)) for asked in (12, 30, 75)]
    for asked, cloud in clouds:
        assert 0.75 * asked <= len(cloud.levels[0].quads) <= asked
        assert cloud.max_plane_distance <= 1.0 and cloud.uncovered_faces == 0
    for (_, fewer), (_, more) in pairwise(clouds):
        assert len(fewer.levels[0].quads) <= len(more.levels[0].quads)
        assert fewer.levels[0].error > more.levels[0].error


@pytest.mark.parametrize(("method", "mesh", "asked"), [("hough", shapes.sphere(10), 40), ("decimate", shapes.box(cuts=2), 6)])
def test_every_method_keeps_to_a_budget(method, mesh, asked):
    cloud = cloud_of(mesh, quads=asked, levels=1, method=method)
    assert 0.75 * asked <= len(cloud.levels[0].quads) <= asked
    assert cloud.max_plane_distance <= 1.0


@pytest.mark.parametrize(("mesh", "asked"), [(shapes.sphere(8), 1.0), (tree(50), 0.3)], ids=["sphere", "tree"])
def test_texture_of_all_levels_is_what_was_asked_for(mesh, asked):
    cloud = cloud_of(mesh, texture_mb=asked, levels=2)
    assert 0.8 * asked <= megabytes(cloud) <= asked
    assert cloud.max_plane_distance <= 1.0


@pytest.mark.parametrize("part", [0.45, 0.65])
def test_leaves_and_trunk_keep_to_their_parts(part):
    mesh, asked = tree(), 80
    cloud = cloud_of(mesh, quads=asked, loose_part_share=part, levels=1)
    loose, connected = quads_by_kind(mesh, cloud.levels[0])
    assert 0.85 * asked <= loose + connected == len(cloud.levels[0].quads) <= asked
    # Either may take what the other has left of its part.
    assert abs(loose - part * asked) <= 0.12 * asked
    assert abs(connected - (1.0 - part) * asked) <= 0.12 * asked


def test_what_a_box_cannot_use_is_left_to_the_leaves():
    mesh = merge([shapes.box((0.5, 0.5, 2.0), cuts=2), shapes.cards(80, size=0.05)])
    loose, connected = quads_by_kind(mesh, cloud_of(mesh, quads=60, levels=1).levels[0])
    assert connected == 6
    assert 0.85 * 60 <= loose + connected <= 60


def test_a_kind_that_needs_more_than_its_part_shares_one_error_with_the_other():
    mesh = tree()
    cloud = cloud_of(mesh, quads=50, loose_part_share=0.1, levels=1)
    loose, connected = quads_by_kind(mesh, cloud.levels[0])
    assert loose > 0.2 * 50 and connected > 0
    assert loose + connected <= 50


def test_levels_double_the_error_of_each_kind_and_keep_the_larger():
    mesh = tree()
    cloud = cloud_of(mesh, quads=80, levels=3)
    for finer, coarser in pairwise(cloud.levels):
        assert coarser.error == pytest.approx(2.0 * finer.error)
        assert coarser.texel == pytest.approx(2.0 * finer.texel)
        assert len(coarser.quads) <= len(finer.quads)
    assert cloud.max_plane_distance <= 1.0
    assert cloud.uncovered_faces == 0
    assert all((level.quads.owner >= 0).all() and (level.quads.owner < len(level.quads)).all() for level in cloud.levels)


def test_a_budget_that_no_error_meets_is_refused_with_the_number_that_is_needed():
    mesh = shapes.box(cuts=2)
    with pytest.raises(SettingsError, match=r'"mesh" takes at least 6 quads, at the largest error of 25%, and 5 quads were asked for'):
        cloud_of(mesh, quads=5)
    assert len(cloud_of(mesh, quads=6).levels[0].quads) == 6
    with pytest.raises(SettingsError, match=r"takes at least [\d.]+ MB of texture.* and 0.001 MB of texture were asked for"):
        cloud_of(mesh, texture_mb=0.001, levels=1)


def test_quads_that_a_plane_has_no_use_for_cost_no_texture():
    plain, asked = cloud_of(shapes.sheet(), levels=1), cloud_of(shapes.sheet(), quads=100, levels=1)
    assert len(asked.levels[0].quads) == 1
    assert asked.levels[0].error == plain.levels[0].error


def test_more_quads_than_faces_stay_buildable():
    mesh = shapes.sphere(4)
    assert len(cloud_of(mesh, quads=10_000, levels=1).levels[0].quads) <= len(mesh.triangles)


def test_equal_input_gives_equal_clouds():
    first, second = (cloud_of(tree(40), quads=40, levels=2) for _ in range(2))
    for one, other in zip(first.levels, second.levels, strict=True):
        assert one.error == other.error
        assert np.array_equal(one.quads.centers, other.quads.centers)
        assert np.array_equal(one.quads.drawn, other.quads.drawn)


@pytest.mark.parametrize(
    ("mesh", "how"),
    [
        (tree(40), {"levels": 3}),
        (tree(40), {"levels": 2, "method": "hough", "error": 0.04}),
        (shapes.box(cuts=2), {"levels": 2, "method": "decimate", "error": 0.1}),
        (tree(40), {"levels": 2, "quads": 40}),
        (tree(40), {"levels": 2, "texture_mb": 0.1}),
        (tree(40), {"levels": 2, "quads": 40, "loose_part_share": 0.1}),
    ],
    ids=["clusters", "hough", "decimate", "quads", "texture", "one error"],
)
def test_the_bar_never_falls_back(mesh, how):
    fractions = []
    finish(build(mesh, BillboardSettings(**how)), lambda step: fractions.append(step.fraction))
    assert len(fractions) > 5
    assert all(before <= after for before, after in pairwise(fractions))
    assert fractions[0] >= 0.0 and fractions[-1] <= 1.0


def test_the_proximity_graph_is_looked_up_once_a_kind(monkeypatch):
    looked_up = []
    original = primitives_module.neighbour_pairs

    def counted(corners, count):
        looked_up.append(len(corners))
        return original(corners, count)

    monkeypatch.setattr(primitives_module, "neighbour_pairs", counted)
    mesh = tree(40)
    cloud_of(mesh, quads=60, levels=2)
    assert len(looked_up) == 2 and sum(looked_up) == len(mesh.triangles)


@pytest.mark.parametrize(
    ("method", "mesh", "error"),
    [("clusters", shapes.bumpy_sphere(8), 0.02), ("hough", shapes.bumpy_sphere(6), 0.02), ("decimate", shapes.box(cuts=2), 0.05)],
)
def test_levels_above_standing_ones_are_those_of_a_whole_run(method, mesh, error):
    primitives = from_mesh(mesh)
    surfaces = surfaces_of(primitives)
    builder = LevelBuilder(BillboardSettings(method=method), longest_side(primitives.points), StageClock())
    whole = finish(builder.coverings(primitives, surfaces, error, 3))
    finest = finish(builder.coverings(primitives, surfaces, error, 1))
    continued = finish(builder.coverings(primitives, surfaces, error, 3, finest))
    for one, other in zip(whole, continued, strict=True):
        assert np.array_equal(one.owner, other.owner)
        assert [patch.offset for patch in one.patches] == [patch.offset for patch in other.patches]


@pytest.mark.parametrize("part", [0.0, 0.25, 1.0])
def test_kinds_divide_the_primitives_and_the_budget(part):
    mesh = tree(40)
    primitives = from_mesh(mesh)
    surfaces = surfaces_of(primitives)
    kinds = kinds_of(primitives, surfaces, part)
    assert np.array_equal(np.sort(np.concatenate([kind.index for kind in kinds])), np.arange(len(primitives)))
    assert sum(kind.part for kind in kinds) == pytest.approx(1.0)
    for kind in kinds:
        assert kind.part == (part if surfaces.loose[kind.index].all() else 1.0 - part)
        assert np.array_equal(kind.primitives.positions, primitives.positions[kind.index])
        assert np.array_equal(kind.surfaces.parts, surfaces.parts[kind.index])


def test_amounts_are_never_told_smaller_than_they_are():
    assert Budget(5, 0.0).described(6) == "6 quads"
    assert Budget(0, 1.0).described(0.00121) == "0.002 MB of texture"


def attempts_of(used, limit, guess, power):
    """The attempt that a search finds for a law `used` of the error, and all errors it has tried."""
    tried = []

    def steps(share):
        tried.append(share)
        yield Progress(0.5, "")
        return Attempt(share, used(share), [])

    return finish(search(steps, limit, guess, power)), tried


@given(
    power=st.floats(0.7, 2.4),
    believed=st.floats(1.0, 2.0),
    meeting=st.floats(0.002, 0.1),
    miss=st.floats(0.4, 2.5),
    limit=st.integers(30, 5000),
)
def test_a_power_law_is_met_in_few_builds(power, believed, meeting, miss, limit):
    found, tried = attempts_of(lambda share: limit * (meeting / share) ** power, limit, min(meeting * miss, LARGEST), believed)
    assert 0.9 * limit <= found.used <= limit
    assert len(tried) <= MOST_BUILDS


@given(seed=st.integers(0, 2**32 - 1), guess=st.floats(SMALLEST, LARGEST), limit=st.floats(0.0, 1000.0))
def test_whatever_the_counts_do_the_result_is_within_the_limit_or_the_coarsest(seed, guess, limit):
    random = np.random.default_rng(seed)
    found, tried = attempts_of(lambda _share: float(random.choice([random.uniform(1.0, 1000.0), math.inf])), limit, guess, 1.2)
    assert found.used <= limit or found.share == LARGEST
    assert 1 <= len(tried) <= MOST_BUILDS
    assert all(SMALLEST <= share <= LARGEST for share in tried)
