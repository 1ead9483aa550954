"""Viewers for `bench_bdam.py`: random ones above a terrain, and those of a fly-over."""

import math
from collections.abc import Iterator

import numpy as np
from bdam_terrains import CELL_SIZE, FractalTerrain

from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.geometry.viewers import Projection, Viewer, camera_window

SIZE, FIELD_OF_VIEW = (800, 600), 50.0  # pixels; degrees across the width
NEAR, FAR = 1.0, 1e6  # meters
MIN_CLEARANCE, MAX_CLEARANCE = 20.0, 2000.0  # meters above the ground
FLIGHT_FRAMES, FLIGHT_STEP, FLIGHT_CLEARANCE = 200, 100.0, 300.0  # meters
FLIGHT_PITCH = math.radians(-15.0)


def perspective(field_of_view: float = FIELD_OF_VIEW, size: tuple[int, int] = SIZE) -> Projection:
    """Return a projection by its horizontal field of view in degrees."""
    extent = 2.0 * math.tan(math.radians(0.5 * field_of_view))
    return Projection("perspective", camera_window(extent, True, (0.0, 0.0), size), size, NEAR, FAR)


def look(position: np.ndarray, heading: float, pitch: float, projection: Projection) -> Viewer:
    """Return a viewer at a position (3,) that looks along `heading`, counterclockwise from east, and up by `pitch`, both in radians."""
    forward = np.array([math.cos(heading) * math.cos(pitch), math.sin(heading) * math.cos(pitch), math.sin(pitch)])
    right = np.array([math.sin(heading), -math.cos(heading), 0.0])
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = right, np.cross(right, forward), -forward, position
    return Viewer(matrix, projection)


def draw_viewer(random: np.random.Generator, store: TerrainStore, heights: np.ndarray, exaggeration: float = 1.0) -> Viewer:
    """Return a random viewer above the terrain, whose heights (H, W) are in meters, with a field of view of 20 to 90 degrees."""
    rows, columns = heights.shape
    column, row = int(random.integers(columns)), int(random.integers(rows))
    x, y = store.frame.to_local(np.array([column]), np.array([row]))
    clearance = float(np.exp(random.uniform(np.log(MIN_CLEARANCE), np.log(MAX_CLEARANCE))))
    position = np.array([x[0], y[0], exaggeration * float(heights[row, column]) + clearance])
    toward = math.atan2(rows / 2 - row, columns / 2 - column)  # mostly into the field
    heading = toward + float(random.normal(scale=0.8))
    return look(position, heading, math.radians(float(random.uniform(-45.0, 0.0))), perspective(float(random.uniform(20.0, 90.0))))


def project_displacements(viewer: Viewer, positions: np.ndarray, heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far in pixels (N,) the images of positions (N, 3) move if their heights become `heights` (N,).

    Also returns whether each position is in the image (N,); positions that are hidden by others count as in it.
    """
    pixels, depths = viewer.project(positions)
    moved = positions.copy()
    moved[:, 2] = heights
    moved_pixels, moved_depths = viewer.project(moved)
    is_visible = (depths > viewer.projection.near) & (pixels >= 0.0).all(axis=1) & (pixels <= viewer.projection.size).all(axis=1)
    distances = np.linalg.norm(moved_pixels - pixels, axis=1)
    return np.where(moved_depths > 0.0, distances, np.inf), is_visible


def sample_positions(store: TerrainStore, heights: np.ndarray) -> np.ndarray:
    """Return all samples of a field (H, W) in local meters, (H W, 3) float64."""
    y, x = np.mgrid[: heights.shape[0], : heights.shape[1]]
    return np.stack([*store.frame.to_local(x.ravel(), y.ravel()), heights.ravel()], axis=1)


def nearest_visible(viewer: Viewer, store: TerrainStore, heights: np.ndarray) -> float:
    """Return the vertical error in meters that covers one pixel at the sample in the image where it covers most."""
    positions = sample_positions(store, heights)
    step = 0.01
    distances, is_visible = project_displacements(viewer, positions, positions[:, 2] + step)
    return step / float(distances[is_visible].max(initial=1e-9))


def fly_over(terrain: FractalTerrain, store: TerrainStore) -> Iterator[Viewer]:
    """Yield the viewers of a flight to the east across the center of a terrain, above the ground by at least FLIGHT_CLEARANCE."""
    row = terrain.size // 2
    ground = terrain.read(slice(row, row + 1))[0]
    step = min(FLIGHT_STEP, 0.8 * CELL_SIZE * (terrain.size - 1) / FLIGHT_FRAMES)
    columns = 0.1 * (terrain.size - 1) + np.arange(FLIGHT_FRAMES) * step / CELL_SIZE
    reach = int(2000.0 / CELL_SIZE)
    projection = perspective()
    for column in columns:
        around = ground[max(int(column) - reach, 0) : int(column) + reach + 1]
        x, y = store.frame.to_local(np.array([column]), np.array([float(row)]))
        yield look(np.array([x[0], y[0], float(around.max()) + FLIGHT_CLEARANCE]), 0.0, FLIGHT_PITCH, projection)
