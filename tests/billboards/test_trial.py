"""Tests of estimates by a trial: within 1.5 times of the build on every level, and equal to it where the source has few triangles."""

import math
from dataclasses import astuple

import numpy as np
import pytest

from farfield.addon.core.billboards import trial
from farfield.addon.core.billboards.build import build_cloud
from farfield.addon.core.billboards.estimate import BYTES_PER_TEXEL
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.errors import GeometryError, SettingsError
from farfield.addon.core.geometry.mesh import PointCloud, TriangleMesh, concatenate, connected_components
from farfield.addon.core.jobs.progress import run_to_end
from shapes import box, bumpy_sphere, leaf_cards, sphere

FACTOR = 1.5


def estimate(source, **settings):
    return run_to_end(trial.estimate_by_trial(trial.prepare_trial(source, "source"), BillboardSettings(**settings)))


def build(source, **settings):
    """Return the figures of each level, as in an estimate."""
    levels = run_to_end(build_cloud(source, BillboardSettings(**settings), "source")).levels
    return [
        (
            level.error,
            level.triangle_count,
            level.chart_triangle_count,
            len(level.quads),
            level.texel_count,
            math.prod(level.atlas.size) * BYTES_PER_TEXEL,
        )
        for level in levels
    ]


def wavy_sphere(rings: int) -> TriangleMesh:
    """Return a sphere with waves of a tenth of its radius."""
    mesh = sphere(rings)
    x, y, z = mesh.vertices.T
    return TriangleMesh(mesh.vertices * (1.0 + 0.1 * np.sin(6.0 * x) * np.cos(5.0 * y + z))[:, None], mesh.triangles)


def scattered_boxes(count: int, cuts: int) -> TriangleMesh:
    """Return boxes of random places and sizes, each a component of its own."""
    random = np.random.default_rng(5)
    boxes = []
    for _ in range(count):
        one = box(cuts=cuts)
        boxes.append(TriangleMesh(one.vertices * random.uniform(0.05, 0.3, 3) + random.uniform(-1.0, 1.0, 3), one.triangles))
    return concatenate(boxes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "settings"),
    [(bumpy_sphere(4), {"error": 0.04}), pytest.param(box(cuts=1), {"quads": 8}, marks=pytest.mark.exhaustive)],
    ids=["bumpy sphere", "budget for a box"],
)
def test_a_small_source_is_estimated_exactly(source, settings):
    settings = {"levels": 2} | settings
    assert [astuple(level) for level in estimate(source, **settings)] == build(source, **settings)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "solid_parts"),
    [
        (wavy_sphere(20), "mesh"),
        pytest.param(scattered_boxes(10, 4), "mesh", marks=pytest.mark.exhaustive),
        (scattered_boxes(6, 4), "quads"),
        pytest.param(wavy_sphere(20), "quads", marks=pytest.mark.exhaustive),
    ],
    ids=["waves", "boxes", "quads of boxes", "quads of waves"],
)
def test_estimates_are_within_one_and_a_half_times_on_every_level(source, solid_parts, monkeypatch):
    monkeypatch.setattr(trial, "MAX_PRIMITIVES", len(source.triangles) // 3)
    settings = {"error": 0.03, "levels": 2, "solid_parts": solid_parts}
    estimated, built = estimate(source, **settings), build(source, **settings)
    assert len(estimated) == len(built)
    for level, figures in zip(estimated, built, strict=True):
        error, triangles, mesh_triangles, quads, texels, size = np.array(astuple(level)) / np.maximum(figures, 1e-9)
        assert error == pytest.approx(1.0, rel=0.01)
        ratios = np.array([triangles, texels, size])
        if solid_parts == "quads":  # A mesh has few charts, whose number varies most, and costs nothing by itself.
            assert mesh_triangles == 0.0
            ratios = np.append(ratios, quads)
        assert (ratios < FACTOR).all() and (ratios > 1.0 / FACTOR).all()


def test_parts_of_a_reduced_source_stay_separate(monkeypatch):
    source = scattered_boxes(10, 6)
    monkeypatch.setattr(trial, "MAX_PRIMITIVES", len(source.triangles) // 2)
    reduced = trial.prepare_trial(source, "source").geometry
    assert 0 < len(reduced.triangles) <= len(source.triangles) // 2
    assert connected_components(reduced.vertices, reduced.triangles).max() == 9


def test_leaves_that_would_vanish_are_sampled(monkeypatch):
    monkeypatch.setattr(trial, "MAX_PRIMITIVES", 40)
    leaves = leaf_cards(100)
    assert trial.prepare_trial(leaves, "leaves").geometry is None
    assert estimate(leaves, levels=1)[0].quads > 1


def test_points_are_thinned_and_keep_their_area(monkeypatch):
    monkeypatch.setattr(trial, "MAX_PRIMITIVES", 500)
    normals = sphere(20).vertices / np.linalg.norm(sphere(20).vertices, axis=1, keepdims=True)
    cloud = PointCloud(normals, normals, np.full(len(normals), 0.1))
    reduced = trial.prepare_trial(cloud, "points").geometry
    assert len(reduced.points) == 500
    assert (reduced.radii**2).sum() == pytest.approx((cloud.radii**2).sum())


def test_unusable_sources_and_budgets_are_refused():
    with pytest.raises(GeometryError, match="Bare"):
        trial.prepare_trial(TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), "Bare")
    with pytest.raises(SettingsError, match="set only one budget"):
        estimate(box(cuts=1), quads=20, triangles=40)
