"""A level between the finest one and the next: only packages have one, and only where it pays for its bytes."""

from dataclasses import replace

import numpy as np
import pytest
from reference.mesh_decoding import decode_level

from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.packages.files import MESH
from farfield.addon.core.packages.increments import Increments
from farfield.addon.core.packages.inserted_levels import find_bytes, is_worthwhile, leave_out_error
from farfield.addon.core.packages.manifest import MeshLevel, Section
from farfield.addon.core.packages.material_sources import MaterialSource
from farfield.addon.core.packages.package import Package, build_package
from farfield.addon.core.packages.planning import ErrorTable, PlanRow
from farfield.addon.core.packages.settings import PackageSettings
from farfield.addon.core.packages.textures.building import BuiltTextures
from farfield.addon.core.texmesh.level_chain import AllSettings, LevelChain, leave_out_inserted, make_levels
from farfield.addon.core.texmesh.perception.settings import PerceptionSettings
from farfield.addon.core.texmesh.scale_space.settings import ScaleSpaceSettings
from farfield.addon.core.texmesh.settings import LevelSettings
from farfield.addon.core.texmesh.simplification.settings import SimplificationSettings
from packed_meshes import order_with_levels, pack
from textured_levels import textured_sphere
from textured_models import check_subset, torus

SUBSET = LevelSettings(product="subset")


def make_settings(levels: LevelSettings = SUBSET) -> AllSettings:
    return AllSettings(levels, ScaleSpaceSettings(), SimplificationSettings(), PerceptionSettings(views=2, max_image=64))


def make_chain(inserted: float, levels: LevelSettings = SUBSET) -> LevelChain:
    return run_to_end(make_levels(textured_sphere(20, 0.2), [None], make_settings(levels), inserted=inserted))


def count_triangles(chain: LevelChain) -> list[int]:
    return [len(level.mesh.triangles) for level in chain.levels]


def test_a_level_is_inserted_below_the_finest_one():
    mesh, chain = textured_sphere(20, 0.2), make_chain(0.65)
    assert [level.is_inserted for level in chain.levels] == [False, True] + [False] * (len(chain.levels) - 2)
    level, following = chain.levels[1], chain.levels[2]
    assert 0.55 * len(mesh.triangles) < len(level.mesh.triangles) <= 0.65 * len(mesh.triangles)
    assert level.switch.pixels >= following.switch.pixels and level.pixel_size <= following.pixel_size
    check_subset(mesh, level.subset)
    others, without = leave_out_inserted(chain).levels, make_chain(0.0).levels
    for first, second in zip(others, without, strict=True):
        np.testing.assert_array_equal(first.mesh.vertices, second.mesh.vertices)
        np.testing.assert_array_equal(first.mesh.wedge_triangles, second.mesh.wedge_triangles)


def test_a_level_that_is_hardly_finer_than_the_next_is_left_out():
    counts = count_triangles(make_chain(0.65))
    chain = make_chain(1.1 * counts[2] / counts[0])
    assert not any(level.is_inserted for level in chain.levels)
    assert not any(level.is_inserted for level in make_chain(0.9).levels)


@pytest.mark.parametrize(
    "levels", [LevelSettings(), replace(SUBSET, choice="count", levels=3), replace(SUBSET, choice="ratio", ratio="0.4, 0.1")]
)
def test_refit_levels_and_those_that_were_asked_for_have_none(levels):
    with_it, without = make_chain(0.65, levels), make_chain(0.0, levels)
    assert count_triangles(with_it) == count_triangles(without)
    for first, second in zip(with_it.levels, without.levels, strict=True):
        assert not first.is_inserted
        np.testing.assert_array_equal(first.mesh.vertices, second.mesh.vertices)


def make_level(size: int, overhead: int) -> MeshLevel:
    """Return a level with so many bytes, of which `overhead` are those of its triangles."""
    nothing = Section(0, 0, 0)
    return MeshLevel(3, 3, (1,), Section(0, size - overhead, 0), nothing, nothing, nothing, Section(0, overhead, 0), 0.0)


FLIPS = np.geomspace(0.2, 0.01, 6)


def make_table(level_errors: tuple[float, ...]) -> ErrorTable:
    return ErrorTable(np.array(level_errors), np.arange(6), FLIPS, 1.5, 0.0)


def make_textures(size: int) -> BuiltTextures:
    """Textures with six states, each of which adds `size` bytes."""
    zeros, states = np.zeros(6, np.int64), np.arange(6)
    return BuiltTextures((), Increments(zeros, states, zeros, zeros + size, states, zeros + 5), bytes(6 * size), FLIPS)


def test_a_level_pays_for_its_bytes_where_the_mesh_is_most_of_them():
    levels = [make_level(1000, 100), make_level(4000, 1000), make_level(5000, 1000)]
    assert is_worthwhile(levels, make_table((0.15, 0.02, 0.0)), make_textures(500))
    assert not is_worthwhile(levels, make_table((0.15, 0.149, 0.0)), make_textures(500))


def test_a_level_does_not_pay_beside_large_textures():
    levels = [make_level(1000, 100), make_level(4000, 1000), make_level(5000, 1000)]
    assert not is_worthwhile(levels, make_table((0.15, 0.02, 0.0)), make_textures(1_000_000))


def test_errors_without_a_level_are_those_of_the_others():
    table = leave_out_error(make_table((0.3, 0.2, 0.1, 0.0)))
    assert table.level_errors.tolist() == [0.3, 0.2, 0.0]


def test_bytes_are_those_of_the_first_row_that_is_good_enough():
    plan = (PlanRow(100, 0, 1, 0.1), PlanRow(300, 0, 2, 0.05), PlanRow(900, 1, 2, 0.01))
    assert find_bytes(plan, np.array([0.2, 0.1, 0.09, 0.05, 0.049, 0.01])).tolist() == [100, 100, 300, 300, 900, 900]


def test_a_level_is_of_no_use_where_no_plan_has_the_errors():
    levels = [make_level(1000, 100), make_level(4000, 1000), make_level(5000, 1000)]
    table = replace(make_table((0.15, 0.02, 0.0)), texture_errors=np.geomspace(0.3, 0.2, 6))
    assert not is_worthwhile(levels, table, make_textures(500))


def test_what_the_finest_level_needs_without_the_level_is_estimated_well():
    mesh = torus(60, 40)
    _, with_it = order_with_levels(mesh, (65, 30, 10))
    _, without = order_with_levels(mesh, (30, 10))
    (content, manifest), (smaller, _) = pack(with_it), pack(without)
    level = manifest.levels[-2]
    overhead = level.corners.size + level.wedges.size + level.parents.size
    assert len(content) - overhead == pytest.approx(len(smaller), rel=0.06)
    assert len(content) > len(smaller)


def build_sphere(side: int, noise: float) -> tuple[Package, tuple[int, ...]]:
    """Return the package of a sphere whose texture has `side` pixels and this standard deviation of noise, and the triangles of its levels
    if none is inserted."""
    mesh = textured_sphere(20, 0.2)
    colors = (0.5 + noise * np.random.default_rng(4).normal(size=(side, side, 3))).astype(np.float32)
    image = np.rint(255.0 * np.clip(colors, 0.0, 1.0)).astype(np.uint8)
    materials = [MaterialSource("m", (1.0, 1.0, 1.0, 1.0), False, {"base_color": image})]
    package = run_to_end(build_package("sphere", mesh, materials, [colors], make_settings(), PackageSettings(pixels=96)))
    return package, tuple(count_triangles(run_to_end(make_levels(mesh, [colors], make_settings()))))


def test_packages_have_the_level_only_if_textures_are_small():
    (small, first), (large, second) = build_sphere(32, 0.0), build_sphere(512, 0.2)
    assert (small.report.levels[0], *small.report.levels[2:]) == first
    assert 0.6 < small.report.levels[1] / small.report.levels[0] <= 0.7
    assert large.report.levels == second
    for package in (small, large):
        manifest, counts = package.manifest, package.report.levels
        assert len(package.report.table.level_errors) == len(counts)
        decoded = [len(decode_level(package.contents[MESH], manifest, index).triangles) for index in range(len(counts))]
        assert tuple(reversed(decoded)) == counts
