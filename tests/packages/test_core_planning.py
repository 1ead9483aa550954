"""Division of bytes between mesh and texture: the prediction of errors, and the plan."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.imaging.mipmaps import build_mipmaps
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.packages.planning import ErrorTable, combine_errors, make_plan, measure_errors
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh

errors = st.floats(0.0, 1.0)


@given(errors, errors, st.floats(1.0, 8.0))
def test_combined_error_is_between_largest_and_sum(first, second, exponent):
    combined = float(combine_errors(first, second, exponent))
    assert max(first, second) - 1e-9 <= combined <= first + second + 1e-9


@given(st.integers(1, 5), st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_plan_is_a_front(levels, states, seed):
    generator = np.random.default_rng(seed)
    table = -np.sort(-generator.random((levels, states)), axis=None).reshape(levels, states)
    mesh_sizes, state_sizes = (np.sort(generator.integers(1, 50_000, count)).tolist() for count in (levels, states))
    plan = make_plan(table.tolist(), mesh_sizes, state_sizes)
    assert all(first.byte_count < second.byte_count and first.error > second.error for first, second in pairwise(plan))
    for row in plan:
        assert row.byte_count == mesh_sizes[row.level] + state_sizes[row.state]
        assert row.error == table[row.level, row.state]
    totals = np.add.outer(mesh_sizes, state_sizes)
    for byte_count in totals.ravel():
        best = min(row.error for row in plan if row.byte_count <= byte_count)
        assert best == table[totals <= byte_count].min()


@given(st.integers(1, 5), st.integers(1, 12), st.integers(0, 2**32 - 1))
def test_predicted_errors_never_rise_and_are_the_measured_ones(levels, states, seed):
    generator = np.random.default_rng(seed)
    predicted = -np.sort(-generator.random(states))
    measured = np.unique(np.linspace(0, states - 1, 4).astype(int))
    level_errors = np.append(-np.sort(-generator.random(levels - 1)), 0.0)
    errors = np.array(ErrorTable(level_errors, measured, 0.8 * predicted[measured], 2.0, 0.0).predict(predicted).tabulate())
    assert errors.shape == (levels, states)
    assert (np.diff(errors, axis=0) <= 0.0).all() and (np.diff(errors, axis=1) <= 0.0).all()
    assert errors[-1, measured] == pytest.approx(0.8 * predicted[measured], abs=1e-4)
    assert (0.8 * predicted - 1e-3 <= errors[-1]).all() and (errors[-1] <= predicted + 1e-3).all()
    assert (errors >= 0.0).all() and (errors <= 1.0).all()


def test_best_use_of_few_bytes_is_the_texture_when_the_mesh_hardly_matters():
    plan = make_plan([[0.5, 0.2, 0.02], [0.5, 0.19, 0.0]], [10, 100_000], [1000, 5000, 10_000])
    assert [(row.level, row.state) for row in plan] == [(0, 0), (0, 1), (0, 2), (1, 2)]


def make_sphere(rings: int) -> TexturedMesh:
    v, u = np.meshgrid(np.linspace(0.0, 1.0, rings + 1), np.linspace(0.0, 1.0, 2 * rings + 1), indexing="ij")
    polar, azimuth = np.pi * v, 2.0 * np.pi * u
    positions = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)], axis=-1).reshape(-1, 3)
    uvs = np.stack([u, v], axis=-1).reshape(-1, 2)
    index = np.arange(len(positions)).reshape(rings + 1, -1)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    mesh = TriangleMesh(positions, triangles, np.zeros(len(triangles), np.int32))
    return build_textured_mesh(mesh, uvs[triangles].astype(np.float32), np.zeros((len(triangles), 3, 0), np.float32), "sphere")


def test_measured_errors_fall_with_levels_and_states():
    levels = [make_sphere(rings) for rings in (4, 8, 24)]
    noise = np.random.default_rng(5).random((64, 64, 3)).astype(np.float32)
    original = [build_mipmaps(noise)]

    def decode(state: int):
        return [build_mipmaps(noise * (state / 8.0) + 0.5 * (1.0 - state / 8.0))]

    table = run_to_end(measure_errors(levels, original, [1, 4, 8], decode, 96, 67.0))
    assert table.level_errors[0] > table.level_errors[1] > table.level_errors[2] == 0.0
    assert table.texture_errors[0] > table.texture_errors[1] > table.texture_errors[2] == 0.0
    assert 1.0 <= table.exponent <= 8.0
    assert table.residual < 0.1


@pytest.mark.slow
def test_the_exponent_predicts_small_errors_as_well_as_large_ones():
    levels = [make_sphere(rings) for rings in (4, 8, 24, 48)]
    noise = np.random.default_rng(5).random((64, 64, 3)).astype(np.float32)

    def decode(count: int):
        return [build_mipmaps(noise * (count / 64.0) + 0.5 * (1.0 - count / 64.0))]

    table = run_to_end(measure_errors(levels, [build_mipmaps(noise)], [1, 32, 56, 62, 64], decode, 96, 67.0))
    reference, rough = decode(64), decode(62)
    partner = int(np.abs(np.log(table.level_errors[:-1] / table.texture_errors[3])).argmin())
    both = run_to_end(measure_errors([levels[partner], levels[-1]], reference, [62], lambda _: rough, 96, 67.0))
    assert both.level_errors[0] == pytest.approx(table.level_errors[partner])
    predicted = float(combine_errors(table.level_errors[partner], table.texture_errors[3], table.exponent))
    measured = float(combine_errors(both.level_errors[0], both.texture_errors[0], both.exponent))
    assert predicted == pytest.approx(measured, rel=0.15)
