"""Renders of textured meshes are what geometry predicts, and levels switch where FLIP sees no difference."""

import itertools
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from farfield.addon.core.geometry.cameras import pixel_size_at, switch_distance
from farfield.addon.core.geometry.directions import fibonacci_sphere
from farfield.addon.core.imaging.mipmaps import build_mipmaps, resize_by_area
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.corner_normals import find_corner_normals
from farfield.addon.core.texmesh.perception import switch_distances, views
from farfield.addon.core.texmesh.perception.level_images import LevelComparison, LevelImages, measure_difference
from farfield.addon.core.texmesh.perception.switch_distances import Switch
from farfield.addon.core.texmesh.settings import TexmeshSettings
from textured_levels import checkered, textured_sphere

SETTINGS = TexmeshSettings(views=4, max_image=128)
TEXTURES = [build_mipmaps(checkered())]


def surfaces(*rings: int) -> list[views.ViewedSurface]:
    return [views.prepare_surface(textured_sphere(count), TEXTURES) for count in rings]


@cache
def open_image(rings: int) -> LevelImages:
    """The images of a sphere, which tests share: most of the time is that of renders."""
    frame = views.frame_around(textured_sphere(32).vertices)
    return LevelImages(surfaces(rings)[0], frame, fibonacci_sphere(SETTINGS.views), SETTINGS.pixels_per_degree)


def open_images(*rings: int) -> list[LevelImages]:
    return [open_image(count) for count in rings]


def find_switches(levels: list[views.ViewedSurface], settings: TexmeshSettings = SETTINGS) -> list[Switch]:
    return compare_images(switch_distances.open_images(levels, settings), settings)


def compare_images(images: list[LevelImages], settings: TexmeshSettings = SETTINGS, gap: int = 0) -> list[Switch]:
    return run_to_end(switch_distances.find_switches(images, settings, gap))


def test_axes_of_views_are_right_handed():
    for direction in [*fibonacci_sphere(8), np.array([0.0, 0.0, 1.0])]:
        axes = views.view_axes(direction)
        assert np.allclose(axes @ axes.T, np.eye(3)) and np.linalg.det(axes) > 0.0


def test_a_render_shows_the_disc_of_a_sphere_lit_from_the_viewer():
    surface = views.prepare_surface(textured_sphere(64), [None])
    frame = views.frame_around(surface.vertices)
    image = views.render(surface, fibonacci_sphere(3)[1], frame, 200)
    assert abs(image.coverage.mean() - math.pi / frame.side**2) < 2e-3
    assert np.allclose(image.colors[100, 100], views.PLAIN_COLOR, atol=0.01)
    offset = int(0.5 / frame.side * 200)  # halfway to the rim, where the normal deviates by 30 degrees
    expected = views.PLAIN_COLOR * (views.AMBIENT + (1.0 - views.AMBIENT) * math.cos(math.radians(30.0)))
    assert np.allclose(image.colors[100 + offset, 100], expected, atol=0.01)
    assert np.allclose(image.colors[0, 0], views.BACKGROUND)


def test_small_renders_are_resized_large_ones():
    surface = surfaces(24)[0]
    frame, direction = views.frame_around(surface.vertices), fibonacci_sphere(4)[0]
    small, large = (resize_by_area(views.render(surface, direction, frame, size).colors, 32) for size in (64, 512))
    assert np.abs(small - large).mean() < 0.02


def test_meshes_without_normals_are_shaded_flat():
    mesh = textured_sphere(8)
    faces = np.cross(*(mesh.vertices[mesh.triangles[:, k]] - mesh.vertices[mesh.triangles[:, 0]] for k in (1, 2)))
    faces /= np.linalg.norm(faces, axis=1, keepdims=True)
    assert np.abs(find_corner_normals(mesh) - faces[:, None]).max() < 1e-6


def test_equal_levels_switch_at_the_nearest_distance():
    (switch,) = find_switches(surfaces(12, 12))
    assert switch.difference == 0.0 and switch.pixels == 128 and switch.limit == "nearest"


@pytest.mark.slow
def test_levels_look_the_same_where_they_switch_and_differ_nearer():
    images = open_images(32, 16, 8, 5)
    switches = compare_images(images)
    sizes = [switch.pixel_size for switch in switches]
    assert sizes == sorted(sizes) and sizes[-1] > 3.0 * sizes[0]
    for index, switch in enumerate(switches):
        assert switch.limit != "farthest" and switch.difference <= 0.04 and switch.local_difference <= 0.2
        pair = images[index : index + 2]
        others = [replace(each, directions=fibonacci_sphere(5), renders={}, images={}) for each in pair]
        other_views = measure_difference(*others, switch.pixels, range(5))
        assert other_views.means.max() <= 0.05
        if switch.limit == "":
            nearer = measure_difference(*pair, min(3 * switch.pixels, 128), range(SETTINGS.views))
            assert nearer.is_seen(SETTINGS)


def test_levels_of_opposite_colors_switch_where_the_object_is_smaller_than_a_pixel():
    first, second = (views.prepare_surface(textured_sphere(8), [build_mipmaps(np.full((2, 2, 3), color, np.float32))]) for color in (0, 1))
    (switch,) = find_switches([first, second])
    assert switch.limit == "farthest" and switch.pixels == 1


def test_a_stricter_limit_moves_switches_away():
    images = open_images(32, 8)
    (usual,) = compare_images(images)
    strict = TexmeshSettings(views=4, max_image=128, max_difference=0.01)
    (far,) = compare_images(images, strict)
    assert far.pixel_size > usual.pixel_size


def test_a_large_object_switches_farther_away():
    small, large = textured_sphere(24), textured_sphere(24)
    coarse = textured_sphere(8)
    sizes = []
    for scale in (1.0, 10.0):
        scaled = [type(small)(**{**vars(mesh), "vertices": scale * mesh.vertices}) for mesh in (large, coarse)]
        levels = [views.prepare_surface(mesh, TEXTURES) for mesh in scaled]
        sizes.append(find_switches(levels)[0].pixel_size)
    assert sizes[1] == pytest.approx(10.0 * sizes[0], rel=0.1)
    distance = switch_distance(sizes[0], math.radians(40.0), 1080)
    assert pixel_size_at(distance, math.radians(40.0), 1080) == pytest.approx(sizes[0])


def test_screen_coverage_is_that_of_a_disc():
    assert switch_distances.screen_coverage(0.1, 1.0, (100, 100)) == pytest.approx(math.pi * 0.01)
    assert [switch_distances.screen_coverage(size, 1.0, (100, 100)) for size in (0.0, 1e-300, 1e-9)] == [1.0] * 3


@pytest.mark.slow
def test_images_do_not_grow_along_a_chain_and_with_a_gap_they_shrink():
    images = open_images(32, 8, 31, 30, 5)  # the second one is worse than those that follow
    pixels = [switch.pixels for switch in compare_images(images)]
    assert pixels == sorted(pixels, reverse=True) and len(set(pixels)) < len(pixels)
    pixels = [switch.pixels for switch in compare_images(images, gap=1)]
    assert all(first > second for first, second in itertools.pairwise(pixels))


def test_levels_that_would_never_be_shown_are_left_out():
    images = open_images(32, 8, 31, 5)
    shown, switches = run_to_end(switch_distances.find_shown_levels(images, SETTINGS))
    assert shown == [0, 2, 3]
    again = compare_images([images[index] for index in shown])
    assert [switch.pixels for switch in switches] == pytest.approx([switch.pixels for switch in again], rel=0.05, abs=1.0)


@pytest.mark.parametrize(
    "segments",
    [
        (32, 31, 30, 12, 10, 5),
        (32, 5, 32, 31, 30),
        *(pytest.param(each, marks=pytest.mark.exhaustive) for each in ((32, 8, 7, 6, 5), (32, 31, 30))),
    ],
)
def test_sizes_of_images_at_switches_decrease_in_proportion(segments):
    shown, switches = run_to_end(switch_distances.find_shown_levels(open_images(*segments), SETTINGS))
    pixels = [switch.pixels for switch in switches]
    assert all(first >= switch_distances.MIN_SWITCH_RATIO * second for first, second in itertools.pairwise(pixels))
    assert len(shown) == len(pixels) + 1 and not any(switch.difference > SETTINGS.max_difference for switch in switches)


def test_a_comparison_ends_where_the_difference_is_seen():
    images = switch_distances.open_images(surfaces(32, 8), SETTINGS)
    comparison = LevelComparison(*images, SETTINGS, [2, 0, 1, 3])
    assert comparison.examine(100).is_seen(SETTINGS)
    assert len(images[0].images) == 2 and sorted(comparison.ranking) == [0, 1, 2, 3]
    everything = measure_difference(*images, 6, range(4))
    order = np.argsort(-everything.measure_ratios(SETTINGS))
    assert not comparison.examine(6).is_seen(SETTINGS) and comparison.ranking == order.tolist()
