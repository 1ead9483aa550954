"""Leaves on one quad do not shade each other; the fit gives crowns the luminance of their source, and leaves other clouds as they are."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

import shapes
from bridge import blender_scenes
from farfield.addon.bridge.billboards import luminance_fit
from farfield.addon.bridge.billboards.capture import capture_textures
from farfield.addon.bridge.billboards.clouds import create_level_object
from farfield.addon.bridge.billboards.luminance_fit import fit_luminance
from farfield.addon.bridge.geometry.mesh_arrays import write_triangles
from farfield.addon.core.billboards.build import build_cloud
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.imaging.colors import LUMINANCE
from farfield.addon.core.jobs.progress import run_to_end
from lib.studio import open_studio

SETTINGS = BillboardSettings(levels=1, error=0.05, samples=4)
USUAL = {name: getattr(luminance_fit, name) for name in ("VIEW_COUNT", "RESOLUTION")}  # before the fixture `extension` changes them


@pytest.fixture(scope="module", autouse=True)
def usual_renders():
    """Fits look at as many and as large renders as outside of tests."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in USUAL.items():
            patch.setattr(luminance_fit, name, value)
        yield


def build(item, settings=SETTINGS):
    """Return the source of an object, its cloud and the captured textures."""
    source = blender_scenes.read_objects(item)
    cloud = run_to_end(build_cloud(source.geometry, settings, source.name))
    return source, cloud, run_to_end(capture_textures(source, cloud, settings))


@pytest.fixture(scope="module")
def crown():
    """A dense crown of opaque leaves, as `build` returns it, and its object."""
    blender_scenes.reset_scene()
    mesh = bpy.data.meshes.new("Crown")
    leaves = shapes.leaf_cards(800, 0.098, 0.2)
    write_triangles(mesh, leaves.vertices, leaves.triangles)
    mesh.materials.append(blender_scenes.create_material("Leaf", (0.3, 0.5, 0.1), 1.0))
    item = bpy.data.objects.new("Crown", mesh)
    bpy.context.scene.collection.objects.link(item)
    return (*build(item, replace(SETTINGS, error=0.07)), item)


@pytest.fixture(scope="module")
def fitted(crown):
    """The fitted textures of the crown."""
    source, cloud, textures, item = crown
    return run_to_end(fit_luminance(source, [item], cloud, textures))[0]


def sum_colors(items, source):
    """Return the sums (6, 4) of color and coverage of six renders of `items` under the sky from directions that the fit does not use."""
    center = source.mesh.vertices.mean(axis=0)
    with open_studio(items, 8) as studio:
        studio.sun.hide_render = True
        directions = np.array(
            [[0.6, -0.64, 0.48], [-0.48, 0.6, 0.64], [0.64, 0.6, 0.48], [-0.6, -0.64, 0.48], [0.6, 0.0, 0.8], [0.0, -0.8, 0.6]]
        )
        return np.array([studio.render(items, direction, center, 0.03, 100).sum(axis=(0, 1)) for direction in directions])


@pytest.mark.slow
def test_crowns_are_as_bright_as_their_source(crown, fitted):
    source, cloud, textures, item = crown
    wanted = sum_colors([item], source)
    before, after = (
        sum_colors([create_level_object("Crown", cloud.levels[0], maps, source.origin)], source) / wanted for maps in (textures[0], fitted)
    )
    assert abs((before[:, 1] / before[:, 3]).mean() - 1.0) > 0.04, "there is something to fit"
    ratios = after[:, 1] / after[:, 3]
    assert abs(ratios.mean() - 1.0) < 0.02 and (np.abs(ratios - 1.0) < 0.05).all()  # Directions differ by noise, which processors change.
    assert np.abs(after - 1.0).sum() < np.abs(before - 1.0).sum()


@pytest.mark.slow
def test_darkened_colors_can_be_restored(crown, fitted):
    textures = crown[2]
    near_visibility = fitted.front.near_visibility
    is_darkened = (near_visibility < 0.97) & (textures[0].front.color[..., 3] > 0.5)
    before, after = (maps.color[is_darkened] for maps in (textures[0].front, fitted.front))
    straight = (after[:, :3] @ LUMINANCE) / after[:, 3] / near_visibility[is_darkened]
    assert is_darkened.sum() > 100
    np.testing.assert_allclose(straight, (before[:, :3] @ LUMINANCE) / before[:, 3], rtol=0.01)


@pytest.mark.slow
def test_wrong_colors_are_corrected():
    item = blender_scenes.box(material=blender_scenes.create_material("Red", (0.7, 0.3, 0.2), 1.0))
    source, cloud, textures = build(item)
    true = textures[0].front
    dark = replace(textures[0], front=replace(true, color=true.color * np.float32([0.6, 0.6, 0.6, 1.0])))
    (fitted,) = run_to_end(fit_luminance(source, [item], cloud, [dark]))
    covered = true.color[..., 3] > 0.9
    assert (fitted.front.color[covered] / true.color[covered])[:, :3].mean(axis=0) == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_objects_that_moved_change_nothing(crown):
    source, cloud, textures, item = crown
    item.location.x += 3.0
    fitted = run_to_end(fit_luminance(source, [item], cloud, textures))
    item.location.x -= 3.0
    assert fitted[0] is textures[0]


@pytest.mark.slow
def test_solids_keep_their_color_and_opacity():
    item = blender_scenes.ball(material=blender_scenes.create_material("Red", (0.8, 0.2, 0.1), 0.6), segments=12)
    source, cloud, textures = build(item)
    (fitted,) = run_to_end(fit_luminance(source, [item], cloud, textures))
    covered = textures[0].front.color[..., 3] > 0.5
    assert np.abs(fitted.front.color[covered] / textures[0].front.color[covered] - 1.0).mean() < 0.03
    assert np.array_equal(fitted.front.color[..., 3], textures[0].front.color[..., 3])


@pytest.mark.slow
def test_no_data_remains_after_the_fit_or_cancelling(crown):
    source, cloud, textures, item = crown
    before, scene = blender_scenes.count_data(), bpy.context.scene
    cancelled = fit_luminance(source, [item], cloud, textures)
    for _ in range(15):
        next(cancelled)
    assert blender_scenes.count_data() != before
    cancelled.close()
    assert blender_scenes.count_data() == before
    assert bpy.context.scene == scene and not item.hide_render
