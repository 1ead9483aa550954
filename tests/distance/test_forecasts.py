"""What the frames of a camera show is what geometry nodes instance there."""

from collections import Counter

import bpy
import mathutils
import numpy as np
import pytest

from distance_scenes import DISTANCES, SIZES, add_box, add_camera, add_scatter, attach_levels, rendered, shown
from farfield.addon.bridge.distance.assets import AssetSearch
from farfield.addon.bridge.distance.placing import originals_shown
from farfield.addon.bridge.distance.views import choose_frames, place_levels, read_views
from farfield.addon.core.distance.forecasts import (
    MAX_ERROR,
    PlacedLevels,
    Places,
    find_error,
    forecast,
    measure_overhead,
    predict_seconds,
)

pytestmark = pytest.mark.usefixtures("empty_scene")


def placed(nearest: list[float], error_factor: float = 1.0, is_seen: bool = True) -> PlacedLevels:
    sizes = np.array([nearest])
    seen = np.array([is_seen])
    return PlacedLevels(np.array(SIZES), np.array([100, 10, 1]), error_factor, sizes, sizes * 1.001, np.broadcast_to(seen, sizes.shape))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "max_error", "fade_range"),
    [
        ("PERSP", 1.0, 0.3),
        ("PERSP", 2.0, 0.0),
        ("ORTHO", 1.0, 0.0),
        pytest.param("PERSP", 2.0, 0.3, marks=pytest.mark.exhaustive),
        pytest.param("ORTHO", 2.0, 0.3, marks=pytest.mark.exhaustive),
    ],
)
def test_a_forecast_counts_what_a_render_instances(kind, max_error, fade_range):
    camera = add_camera()
    camera.data.type, camera.data.ortho_scale = kind, 33.0
    random = np.random.default_rng(7)
    points = random.uniform((-60.0, -20.0, -3.0), (60.0, 90.0, 3.0), (60, 3))
    scatter = add_scatter(points.tolist(), [add_box("Box", linked=False)])
    scatter.location, scatter.scale = (1.0, 2.0, 0.0), (1.5, 1.5, 1.5)
    (chain,) = attach_levels([scatter], fade_range=fade_range, max_error=max_error)
    scene = bpy.context.scene
    with originals_shown(scene, bpy.context.view_layer) as depsgraph:
        (asset,) = AssetSearch(scene, depsgraph).find([scatter])
        levels = place_levels(asset, chain, 1.0, read_views(scene))
    (counts,) = forecast([levels], max_error, fade_range).counts
    found = Counter(name for name, _ in (rendered() if fade_range else shown()))
    assert {f"Box {number}": count for number, count in enumerate(counts[0]) if count} == found
    assert len(found) > 1 or kind == "ORTHO"


def test_the_nearest_point_of_a_box_that_is_moved_rotated_and_scaled():
    matrix = mathutils.Matrix.LocRotScale((10.0, 0.0, 0.0), mathutils.Euler((0.0, 0.0, 0.25 * np.pi)), (2.0, 1.0, 3.0))
    places = Places(np.array([np.array(matrix)]), np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 2.0]))
    corner = matrix @ mathutils.Vector((-1.0, 1.0, 2.0))
    assert places.distances_to(np.array(corner) + [-3.0, 0.0, 4.0]) == pytest.approx([5.0])
    assert places.distances_to(np.array([10.0, 0.0, 6.5])) == pytest.approx([0.5]), "above"
    assert places.distances_to(np.array([10.5, 0.5, 1.0])) == pytest.approx([0.0]), "inside"


def test_places_that_are_not_seen_are_coarser_and_never_the_original():
    assert forecast([placed([0.0, 0.012, 0.013], is_seen=False)], 1.0, 0.2).counts[0].tolist() == [[0, 2, 1]]


def test_triangles_of_several_assets_and_an_error_factor():
    found = forecast([placed([0.03]), placed([0.03], error_factor=2.0)], 1.0, 0.0)
    assert [counts.tolist() for counts in found.counts] == [[[0, 1, 0]], [[0, 0, 1]]] and found.triangles.tolist() == [11]


def test_the_smallest_error_that_fits_is_found():
    assert find_error(lambda error: error >= 3.0, 1.0) == pytest.approx(3.0, rel=1e-5)
    assert find_error(lambda error: error > 0.0, 1.5) == 1.5
    assert find_error(lambda error: error > MAX_ERROR, 1.0) is None


def test_frames_of_a_camera_that_moves_with_its_parent_or_by_markers():
    camera, scene = add_camera(DISTANCES[0]), bpy.context.scene
    scene.frame_start, scene.frame_end, scene.frame_current = 1, 100, 7
    assert choose_frames(scene) == [7]
    camera.parent = bpy.data.objects.new("Parent", None)
    camera.parent.keyframe_insert("location", frame=1)
    assert choose_frames(scene, 3) == [1, 50, 100]
    camera.parent = None
    scene.timeline_markers.new("Cut", frame=20).camera = camera
    assert choose_frames(scene, 2) == [1, 100]


def test_a_search_with_few_steps_tries_both_ends_and_so_many_errors_between():
    tried = []

    def fits(error: float) -> bool:
        tried.append(error)
        return error >= 3.0

    assert find_error(fits, 1.0, steps=2) == pytest.approx(4.0)
    assert tried == pytest.approx([1.0, MAX_ERROR, 4.0, 2.0])


@pytest.mark.parametrize("overhead", [0.0, 1.5])
def test_seconds_follow_from_a_render_with_one_sample_and_one_with_some(overhead):
    single, eight = overhead + 0.25, overhead + 8 * 0.25
    assert measure_overhead(single, eight, 8) == pytest.approx(overhead)
    assert predict_seconds(eight, 8, 64, overhead) == pytest.approx(overhead + 64 * 0.25)


def test_noise_of_times_gives_no_impossible_overhead():
    assert measure_overhead(1.0, 0.9, 8) == 1.0 and measure_overhead(1.0, 9.0, 8) == 0.0 and measure_overhead(1.0, 1.0, 1) == 0.0
    assert predict_seconds(0.9, 8, 64, 1.0) == 1.0
