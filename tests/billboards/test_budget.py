"""Tests of the budgets: the usage is within the budget and close to it, and leaves and trunk keep to their fractions."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import shapes
from farfield.addon.core.billboards import atlas
from farfield.addon.core.billboards import primitives as primitives_module
from farfield.addon.core.billboards.atlas import MAX_TEXELS
from farfield.addon.core.billboards.budget import Budget, read_budget, split_into_groups
from farfield.addon.core.billboards.build import build_cloud
from farfield.addon.core.billboards.error_search import MAX_BUILDS, MAX_ERROR, MIN_ERROR, Attempt, search_error
from farfield.addon.core.billboards.estimate import BYTES_PER_TEXEL
from farfield.addon.core.billboards.levels import LevelBuilder
from farfield.addon.core.billboards.primitives import find_components, from_mesh
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.errors import SettingsError
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate, longest_side
from farfield.addon.core.jobs.progress import Progress, StageClock, run_to_end

EXHAUSTIVE = pytest.mark.exhaustive


def build_test_cloud(mesh, **settings):
    """Build with quads only by default: `test_parts` tests budgets of meshes."""
    return run_to_end(build_cloud(mesh, BillboardSettings(**({"solid_parts": "quads"} | settings)), "mesh"))


def tree(leaves=40, sides=16, cuts=6):
    """Return a curved trunk of 2 x `sides` x `cuts` triangles, one connected surface, under a ball of loose cards."""
    trunk = shapes.cylinder(radius=0.5, length=2.0, sides=sides, cuts=cuts)
    bent = (
        trunk.vertices + np.column_stack([0.3 * np.sin(2.0 * trunk.vertices[:, 2]), np.zeros((len(trunk.vertices), 2))]) - [0.0, 0.0, 2.0]
    )
    return concatenate([TriangleMesh(bent, trunk.triangles), shapes.leaf_cards(leaves, size=0.05)])


def bush():
    """Return a small tree, for promises that do not depend on the number of triangles."""
    return tree(leaves=12, sides=8, cuts=2)


def count_quads(mesh, level):
    """Return how many quads of `level` show loose parts and how many show connected surfaces; none shows both."""
    loose = find_components(from_mesh(mesh)).loose
    drawn_loose = [loose[drawn] for drawn in np.split(level.quads.drawn, level.quads.drawn_offsets[1:-1])]
    assert all(flags.all() or not flags.any() for flags in drawn_loose)
    return sum(flags.all() for flags in drawn_loose), sum(not flags.any() for flags in drawn_loose)


def megabytes(cloud):
    return sum(level.atlas.size[0] * level.atlas.size[1] for level in cloud.levels) * BYTES_PER_TEXEL / 1e6


def test_two_budgets_are_rejected():
    with pytest.raises(SettingsError, match="Quads is 10 and Texture MB is 2"):
        build_test_cloud(shapes.sphere(6), quads=10, texture_mb=2.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mesh", "budget"),
    [
        (bush(), 6),
        pytest.param(bush(), 20, marks=EXHAUSTIVE),
        (shapes.soup(20), 10),
        pytest.param(shapes.soup(50), 20, marks=EXHAUSTIVE),
        (shapes.box(cuts=2), 6),
    ],
    ids=["tree", "large tree", "soup", "large soup", "box"],
)
def test_any_number_of_quads_from_six_on_is_reached(mesh, budget):
    cloud = build_test_cloud(mesh, quads=budget, levels=1)
    count = len(cloud.levels[0].quads)
    assert count <= budget and (count >= 0.9 * budget or len(mesh.triangles) == 48)
    assert cloud.max_plane_distance <= 1.0 and cloud.uncovered_faces == 0


@EXHAUSTIVE  # `test_parts` has a budget of triangles.
@pytest.mark.parametrize("budget", [12, 70])
def test_triangles_are_a_budget(budget):
    cloud = build_test_cloud(bush(), triangles=budget, levels=1)
    assert 0.9 * budget <= cloud.levels[0].triangle_count <= budget
    assert cloud.max_plane_distance <= 1.0 and cloud.uncovered_faces == 0


@EXHAUSTIVE  # as the texture of several levels
def test_kilobytes_are_reached():
    cloud = build_test_cloud(bush(), texture_mb=0.02, levels=1)
    assert megabytes(cloud) <= 0.02
    assert cloud.max_plane_distance <= 1.0


def test_default_is_no_budget():
    assert read_budget(BillboardSettings()) is None
    assert read_budget(BillboardSettings(quads=7)).limit == 7
    assert read_budget(BillboardSettings(texture_mb=0.5)).limit == 0.5


@pytest.mark.slow
def test_larger_budgets_give_more_quads_and_smaller_errors():
    clouds = [(budget, build_test_cloud(shapes.bumpy_sphere(4), quads=budget, levels=1)) for budget in (8, 16)]
    for budget, cloud in clouds:
        assert 0.75 * budget <= len(cloud.levels[0].quads) <= budget
        assert cloud.max_plane_distance <= 1.0 and cloud.uncovered_faces == 0
    for (_, fewer), (_, more) in pairwise(clouds):
        assert len(fewer.levels[0].quads) <= len(more.levels[0].quads)
        assert fewer.levels[0].error > more.levels[0].error


@pytest.mark.slow
@pytest.mark.parametrize(("method", "mesh", "budget"), [("hough", shapes.bumpy_sphere(6), 30), ("decimate", shapes.box(cuts=2), 6)])
def test_every_method_keeps_the_budget(method, mesh, budget):
    cloud = build_test_cloud(mesh, quads=budget, levels=1, method=method)
    assert 0.75 * budget <= len(cloud.levels[0].quads) <= budget
    assert cloud.max_plane_distance <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize(("mesh", "budget"), [(shapes.sphere(4), 0.3), pytest.param(bush(), 0.1, marks=EXHAUSTIVE)], ids=["sphere", "tree"])
def test_texture_of_all_levels_meets_the_budget(mesh, budget):
    cloud = build_test_cloud(mesh, texture_mb=budget, levels=2)
    assert 0.8 * budget <= megabytes(cloud) <= budget
    assert cloud.max_plane_distance <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("fraction", [0.65, pytest.param(0.45, marks=EXHAUSTIVE)])
def test_leaves_and_trunk_keep_their_fractions(fraction):
    mesh, budget = tree(leaves=26, sides=12, cuts=3), 34
    cloud = build_test_cloud(mesh, quads=budget, loose_fraction=fraction, levels=1)
    loose, connected = count_quads(mesh, cloud.levels[0])
    assert 0.85 * budget <= loose + connected == len(cloud.levels[0].quads) <= budget
    # Either may use what the other has left of its fraction.
    assert abs(loose - fraction * budget) <= 0.12 * budget
    assert abs(connected - (1.0 - fraction) * budget) <= 0.12 * budget


@pytest.mark.slow
def test_leaves_get_the_unused_budget_of_a_box():
    mesh = concatenate([shapes.box((0.5, 0.5, 2.0), cuts=1), shapes.leaf_cards(50, size=0.05)])
    loose, connected = count_quads(mesh, build_test_cloud(mesh, quads=40, levels=1).levels[0])
    assert connected == 6
    assert 0.85 * 40 <= loose + connected <= 40


@pytest.mark.slow
def test_group_above_its_fraction_gets_the_same_error_as_the_other():
    mesh = bush()
    cloud = build_test_cloud(mesh, quads=12, loose_fraction=0.1, levels=1)
    loose, connected = count_quads(mesh, cloud.levels[0])
    assert loose > 0.2 * 12 and connected > 0
    assert loose + connected <= 12


@pytest.mark.slow
def test_levels_double_the_error_of_each_group_and_have_the_larger():
    mesh = bush()
    cloud = build_test_cloud(mesh, quads=20, levels=3, nested_levels=True)
    for finer, coarser in pairwise(cloud.levels):
        assert coarser.error == pytest.approx(2.0 * finer.error)
        assert coarser.texel_size == pytest.approx(2.0 * finer.texel_size)
        assert len(coarser.quads) <= len(finer.quads)
    assert cloud.max_plane_distance <= 1.0
    assert cloud.uncovered_faces == 0
    assert all((level.quads.owner >= 0).all() and (level.quads.owner < len(level.quads)).all() for level in cloud.levels)


@pytest.mark.slow
def test_too_small_budget_is_rejected_with_the_required_one():
    mesh = shapes.box(cuts=1)
    with pytest.raises(SettingsError, match=r'"mesh" needs at least \d quads, at the largest error of 50%, but Quads is 1'):
        build_test_cloud(mesh, quads=1, levels=1)
    assert len(build_test_cloud(mesh, quads=6, levels=1).levels[0].quads) == 6
    with pytest.raises(SettingsError, match=r"needs at least [\d.]+ MB of texture.* but Texture MB is 0.001"):
        build_test_cloud(mesh, texture_mb=0.001, levels=1)


@pytest.mark.slow
def test_more_quads_than_a_small_mesh_needs_do_not_fill_the_memory():
    """A texture of 12104 x 14008 texels gave the last of 32 faces a quad of its own."""
    sheet = shapes.sheet(4)
    vertices = np.column_stack([sheet.vertices[:, :2], np.random.default_rng(1).uniform(-0.08, 0.08, len(sheet.vertices))])
    level = build_test_cloud(TriangleMesh(vertices, sheet.triangles), quads=35, levels=1, loose_fraction=1.0).levels[0]
    assert len(level.quads) >= 0.8 * len(sheet.triangles)
    assert math.prod(level.atlas.size) <= Budget(35, 0.0).max_texels < MAX_TEXELS


def test_a_texture_that_is_too_large_at_every_error_is_an_error(monkeypatch):
    monkeypatch.setattr(atlas, "MAX_TEXELS", 100)
    with pytest.raises(SettingsError, match=r'"mesh" needs a texture of .* even at the largest error of 50%; use a larger Texel Size'):
        build_test_cloud(shapes.box(cuts=1), quads=6, levels=1)


def test_unnecessary_quads_of_a_plane_cost_no_texture():
    default, budgeted = build_test_cloud(shapes.sheet(), levels=1), build_test_cloud(shapes.sheet(), quads=100, levels=1)
    assert len(budgeted.levels[0].quads) == 1
    assert budgeted.levels[0].error == default.levels[0].error


@pytest.mark.slow
def test_budget_above_the_number_of_faces_is_allowed():
    mesh = shapes.sphere(4)
    assert len(build_test_cloud(mesh, quads=10_000, levels=1).levels[0].quads) <= len(mesh.triangles)


@EXHAUSTIVE  # `test_build` compares the clouds of equal seeds, too.
def test_equal_input_gives_equal_clouds():
    first, second = (build_test_cloud(bush(), quads=10, levels=1, solid_parts="mesh") for _ in range(2))
    for level, repeated in zip(first.levels, second.levels, strict=True):
        assert level.error == repeated.error
        assert np.array_equal(level.quads.centers, repeated.quads.centers)
        assert np.array_equal(level.quads.drawn, repeated.quads.drawn)


@pytest.mark.parametrize(
    ("mesh", "settings"),
    [
        (bush(), {"levels": 2, "error": 0.03}),
        pytest.param(bush(), {"levels": 2, "method": "hough", "error": 0.04}, marks=EXHAUSTIVE),
        pytest.param(shapes.box(cuts=2), {"levels": 2, "method": "decimate", "error": 0.1}, marks=EXHAUSTIVE),
        pytest.param(bush(), {"levels": 2, "quads": 12}, marks=EXHAUSTIVE),
        pytest.param(bush(), {"levels": 2, "quads": 12, "loose_fraction": 0.1}, marks=EXHAUSTIVE),
    ],
    ids=["clusters", "hough", "decimate", "quads", "one error"],
)
def test_progress_never_falls(mesh, settings):
    fractions = []
    run_to_end(build_cloud(mesh, BillboardSettings(**settings)), lambda step: fractions.append(step.fraction))
    assert len(fractions) > 5
    assert all(before <= after for before, after in pairwise(fractions))
    assert fractions[0] >= 0.0 and fractions[-1] <= 1.0


@pytest.mark.slow
def test_proximity_graph_is_built_once_per_group(monkeypatch):
    sizes = []
    original = primitives_module.neighbor_pairs

    def record_size(corners, count):
        sizes.append(len(corners))
        return original(corners, count)

    monkeypatch.setattr(primitives_module, "neighbor_pairs", record_size)
    mesh = bush()
    build_test_cloud(mesh, quads=10, levels=2)
    assert len(sizes) == 2 and sum(sizes) == len(mesh.triangles)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "mesh", "error"),
    [
        ("clusters", shapes.bumpy_sphere(4), 0.08),
        ("hough", shapes.bumpy_sphere(6), 0.02),
        pytest.param("decimate", shapes.box(cuts=2), 0.05, marks=EXHAUSTIVE),
    ],
)
def test_levels_above_finished_ones_equal_a_complete_run(method, mesh, error):
    primitives = from_mesh(mesh)
    components = find_components(primitives)
    builder = LevelBuilder(BillboardSettings(method=method), longest_side(primitives.points), StageClock())
    complete = run_to_end(builder.build_coverings(primitives, components, error, 3))
    finest = run_to_end(builder.build_coverings(primitives, components, error, 1))
    continued = run_to_end(builder.build_coverings(primitives, components, error, 3, finest))
    for expected, covering in zip(complete, continued, strict=True):
        assert np.array_equal(covering.owner, expected.owner)
        assert [patch.offset for patch in covering.patches] == [patch.offset for patch in expected.patches]


@pytest.mark.parametrize("fraction", [0.0, 0.25, 1.0])
def test_groups_divide_the_primitives_and_the_budget(fraction):
    mesh = tree(40)
    primitives = from_mesh(mesh)
    components = find_components(primitives)
    groups = split_into_groups(primitives, components, fraction)
    assert np.array_equal(np.sort(np.concatenate([group.indices for group in groups])), np.arange(len(primitives)))
    assert sum(group.fraction for group in groups) == pytest.approx(1.0)
    for group in groups:
        assert group.fraction == (fraction if components.loose[group.indices].all() else 1.0 - fraction)
        assert np.array_equal(group.primitives.positions, primitives.positions[group.indices])
        assert np.array_equal(group.components.labels, components.labels[group.indices])


def test_amounts_are_rounded_up():
    assert Budget(5, 0.0).format_amount(6) == "6 quads"
    assert Budget(0, 1.0).format_amount(0.00121) == "0.002 MB of texture"


def run_search(usage_of_error, limit, guess, exponent):
    """Return the attempt that a search finds for a usage that is a function of the error, and all errors that it has tried."""
    tried = []

    def build(error):
        tried.append(error)
        yield Progress(0.5, "")
        return Attempt(error, usage_of_error(error), [])

    return run_to_end(search_error(build, limit, guess, exponent)), tried


@given(
    exponent=st.floats(0.7, 2.4),
    assumed_exponent=st.floats(1.0, 2.0),
    solution=st.floats(0.002, 0.1),
    guess_factor=st.floats(0.4, 2.5),
    limit=st.integers(30, 5000),
)
def test_power_law_is_solved_in_few_builds(exponent, assumed_exponent, solution, guess_factor, limit):
    guess = min(solution * guess_factor, MAX_ERROR)
    attempt, tried = run_search(lambda error: limit * (solution / error) ** exponent, limit, guess, assumed_exponent)
    assert 0.9 * limit <= attempt.usage <= limit
    assert len(tried) <= MAX_BUILDS


@given(seed=st.integers(0, 2**32 - 1), guess=st.floats(MIN_ERROR, MAX_ERROR), limit=st.floats(0.0, 1000.0))
def test_result_is_within_the_limit_or_the_coarsest(seed, guess, limit):
    random = np.random.default_rng(seed)
    attempt, tried = run_search(lambda _error: float(random.choice([random.uniform(1.0, 1000.0), math.inf])), limit, guess, 1.2)
    assert attempt.usage <= limit or attempt.relative_error == MAX_ERROR
    assert 1 <= len(tried) <= MAX_BUILDS
    assert all(MIN_ERROR <= error <= MAX_ERROR for error in tried)
