"""Transitions between boxes: what only a finer box resolves ends before its border, and densities near it are those of both."""

import numpy as np
import pytest

from clipbox_borders import count_walls
from farfield.addon.core.clipbox.clearings import find_clearing
from farfield.addon.core.clipbox.nested import NestedBoxes
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.generators import Sampler, build_sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.jobs.progress import run_to_end

TUNNEL_RADIUS = 4.0


def tunnel_in_fine_boxes(grid: Grid) -> np.ndarray:
    """Solid ground with a tunnel along x, which only boxes with voxels of 1 show."""
    _, y, z = grid.coordinates()
    return np.where(grid.voxel_size < 1.5, np.hypot(y, z) - TUNNEL_RADIUS, 50.0)


def settings(**changes) -> ClipboxSettings:
    return ClipboxSettings(**({"terrain": "cascades", "resolution": 64, "boxes": 3} | changes))


def moved_boxes(sampler: Sampler, **changes) -> NestedBoxes:
    boxes = NestedBoxes(sampler, settings(**changes))
    run_to_end(boxes.move(np.zeros(3)))
    return boxes


def test_a_tunnel_narrows_and_closes_before_the_border():
    boxes = moved_boxes(Sampler("tunnel", tunnel_in_fine_boxes))
    visible = boxes.layout.visible[0]
    air = (boxes.window(0, visible.low, visible.high) <= 0).sum(axis=(1, 2))
    half = air[len(air) // 2 :]
    assert half[0] == pytest.approx(np.pi * TUNNEL_RADIUS**2, rel=0.1) and half[-1] == 0
    assert (np.diff(half) <= 0).all() and len(np.unique(half)) >= 4, "a rounded end, not a wall"


@pytest.mark.parametrize("terrain", ["tunnel", "cascades", "spheres"])
def test_no_box_ends_in_a_wall(terrain, monkeypatch):
    source = settings(terrain="spheres" if terrain == "spheres" else "cascades", boxes=4, resolution=48)
    sampler = Sampler("tunnel", tunnel_in_fine_boxes) if terrain == "tunnel" else build_sampler(source)
    viewers = [np.zeros(3) if terrain == "tunnel" else find_clearing(sampler, np.array([180.0, 40.0, -40.0]), 1.0)]
    assert sum(box["walls"] for box in count_walls(sampler, source, viewers)) == 0
    monkeypatch.setattr(NestedBoxes, "transition", lambda *_: None)
    assert sum(box["walls"] for box in count_walls(sampler, source, viewers)) > 10


def test_densities_of_voxels_are_those_of_windows():
    boxes = moved_boxes(build_sampler(settings()))
    for level in range(2):
        visible = boxes.layout.visible[level]
        low, high = visible.low, visible.low + [40, 30, 64]
        corners = np.stack(np.meshgrid(*(np.arange(a + 1, b, 7) for a, b in zip(low, high, strict=True)), indexing="ij"), axis=-1)
        corners = corners.reshape(-1, 3)
        window = boxes.window(level, low, high)
        x, y, z = (corners - low - 1).T
        outside_hole = (
            np.ones(len(corners), bool) if level == 0 else ~boxes.hole(level).contains(corners) & ~boxes.hole(level).contains(corners - 1)
        )
        octants = boxes.gather_octants(level, corners).values[0]
        assert octants[outside_hole].tobytes() == window[x, y, z][outside_hole].tobytes()


def test_a_plane_stays_a_plane():
    boxes = moved_boxes(Sampler("slope", lambda grid: 0.5 * grid.coordinates()[0] + 0.25 * grid.coordinates()[1] - grid.coordinates()[2]))
    visible = boxes.layout.visible[0]
    window, grid = (
        boxes.window(0, visible.low, visible.high),
        Grid(tuple(visible.low.tolist()), tuple((visible.high - visible.low).tolist()), 1.0),
    )
    exact = 0.5 * grid.coordinates()[0] + 0.25 * grid.coordinates()[1] - grid.coordinates()[2]
    near = np.abs(exact) < 1.5
    assert np.abs(window.astype(np.float32) - exact)[near].max() < 2e-3
