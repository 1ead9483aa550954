"""Plants and rocks on terrains: their shapes, and where geometry nodes put them."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from farfield.addon.bridge import scatter, sky
from farfield.addon.bridge.scatter import SCATTER_KEY, Layer
from farfield.addon.compat import set_node_input
from farfield.addon.core import plants
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.scatter import KINDS, ScatterSettings
from farfield.addon.core.sky import SkySettings
from farfield.addon.operators.clipbox.job import prepare
from farfield.addon.operators.job_run import run_job

STEEPEST = 0.8  # z of normals.
NOISE = 0.06  # By which noise moves that limit.


def add_camera(x, y):
    """The active camera of the scene, at a place."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    camera.location = (x, y, 20.0)
    return camera


@pytest.fixture(scope="module")
def terrain():
    """A landscape that is level on one side and steep on the other, under x = 0, with a rise of 60 m."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    settings = ClipboxSettings(terrain="formula", formula="30*tanh(x/16) - z", resolution=32, boxes=3, voxel_size=2.0)
    job = prepare(settings, np.zeros(3))
    run_to_end(run_job(job))
    bpy.context.view_layer.update()
    return job.terrain


@pytest.fixture(autouse=True)
def clean(terrain):
    """A scene without camera and without anything scattered."""
    yield
    scatter.remove_scatter(terrain)
    for camera in list(bpy.data.cameras):
        bpy.data.cameras.remove(camera)


@pytest.fixture
def layer(monkeypatch):
    """One layer of stones that is everywhere on ground that is not steep."""
    layer = Layer("Rock", "Far Rock", 20.0, 1.0, 30.0, 1.0, steepest=STEEPEST, clumps=0.0, align=1.0, is_plant=False, sway=0.1)
    monkeypatch.setitem(scatter.KINDS, "rocks", {"Stones": layer})
    return layer


def places(terrain, item=None):
    """The matrices (N, 4, 4) of everything that is scattered, or that one object scatters, in the order of their places, and the names of
    the meshes there."""
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    owners = set(scatter.find_scatter(terrain)) if item is None else {item}
    found = [
        (np.array(item.matrix_world), item.object.name)
        for item in depsgraph.object_instances
        if item.is_instance and item.parent.original in owners
    ]
    found.sort(key=lambda pair: tuple(pair[0][:2, 3]))
    return np.array([matrix for matrix, _ in found]).reshape(-1, 4, 4), [name for _, name in found]


def test_they_lie_on_ground_that_is_not_too_steep(terrain, layer):
    add_camera(0.0, 0.0)
    scatter.add_scatter(bpy.context.scene, terrain, ScatterSettings(kind="rocks"), 1.0)
    matrices, names = places(terrain)
    assert len(matrices) > 200
    for position in matrices[::7, :3, 3]:
        hits = [item.ray_cast((*position[:2], 500.0), (0.0, 0.0, -1.0)) for item in terrain.ground_objects()]
        ground, normal = max(((hit[1], hit[2]) for hit in hits if hit[0]), key=lambda pair: pair[0].z)
        assert abs(ground.z - position[2]) < 1e-3 and normal.z > STEEPEST - NOISE
    distances = np.linalg.norm(matrices[:, :2, 3], axis=1)
    assert distances.max() < layer.distance
    from_camera = np.linalg.norm(matrices[:, :3, 3] - [0.0, 0.0, 20.0], axis=1)
    assert {name.startswith("Far") for name in np.array(names)[from_camera < layer.far_from - 0.01]} <= {False}
    assert {name.startswith("Far") for name in np.array(names)[from_camera > layer.far_from + 0.01]} == {True}


def test_places_stay_when_the_camera_moves(terrain, layer):
    camera = add_camera(-20.0, 3.0)
    scatter.add_scatter(bpy.context.scene, terrain, ScatterSettings(kind="rocks"), 1.0)
    before, _ = places(terrain)
    camera.location.x -= 7.3
    after, _ = places(terrain)

    def near_both(matrices):
        midpoint = np.array([-23.65, 3.0])
        return matrices[np.linalg.norm(matrices[:, :2, 3] - midpoint, axis=1) < 0.45 * layer.distance]

    assert len(near_both(before)) > 100 and np.allclose(near_both(before), near_both(after), atol=1e-4)


def test_clumps_are_dense_and_leave_gaps(terrain, layer, monkeypatch):
    add_camera(-45.0, 0.0)
    even, clumped = (replace(layer, distance=40.0, clumps=clumps) for clumps in (0.0, 1.0))
    monkeypatch.setitem(scatter.KINDS, "rocks", {"Even": even, "Clumped": clumped, "Other": clumped})
    created = scatter.add_scatter(bpy.context.scene, terrain, ScatterSettings(kind="rocks"), 1.0)
    edges = np.linspace(-18.0, 18.0, 10)
    counts = []
    for item in created:
        positions = places(terrain, item)[0][:, :2, 3]
        counts.append(np.histogram2d(positions[:, 0] + 45.0, positions[:, 1], (edges, edges))[0])
    even, clumped, other = counts
    assert even.min() > 0 and even.var() < 2.0 * even.mean(), "4 m wide squares all have some"
    assert (clumped == 0).mean() > 0.3 and clumped.max() > 0.7 * even.mean() and clumped.var() > 3.0 * clumped.mean()
    assert np.corrcoef(clumped.ravel(), other.ravel())[0, 1] < 0.5, "each kind has clumps of its own"


def test_most_are_small_and_a_few_large(terrain, layer, monkeypatch):
    add_camera(-30.0, 0.0)
    monkeypatch.setitem(scatter.KINDS, "rocks", {"Stones": replace(layer, size=2.0, variation=0.89)})
    scatter.add_scatter(bpy.context.scene, terrain, ScatterSettings(kind="rocks"), 1.0)
    sizes = np.linalg.norm(places(terrain)[0][:, :3, 2], axis=1)
    assert 0.219 < sizes.min() < 0.225 and 1.0 < sizes.max() < 2.001
    expected = 2.0 * plants.sample_sizes(np.array([0.25, 0.5, 0.75, 0.95]), 0.11)
    assert np.quantile(sizes, [0.25, 0.5, 0.75, 0.95]) == pytest.approx(expected, rel=0.15)


def test_they_are_tilted_from_the_normal_of_the_ground(terrain, layer, monkeypatch):
    add_camera(-45.0, 0.0)
    axes = []
    for tilt in (0.0, 0.6):
        monkeypatch.setitem(scatter.KINDS, "rocks", {"Stones": replace(layer, tilt=tilt, variation=0.0)})
        scatter.add_scatter(bpy.context.scene, terrain, ScatterSettings(kind="rocks"), 1.0)
        axes.append(places(terrain)[0][:, :3, 2])
    angles = np.arccos(np.clip((axes[0] * axes[1]).sum(axis=1), -1.0, 1.0))
    assert angles.max() < 0.301 and angles.mean() == pytest.approx(0.15, abs=0.02)


@pytest.mark.parametrize("values", [{"debris": 1.0, "reach": 9.0}, {"hollows": 1.0, "reach": 12.0}], ids=lambda values: next(iter(values)))
def test_debris_lies_below_cliffs_and_trees_grow_in_hollows(terrain, layer, monkeypatch, values):
    camera = add_camera(0.0, 0.0)
    below = replace(layer, steepest=0.0, distance=60.0, **values)
    monkeypatch.setitem(scatter.KINDS, "rocks", {"Stones": below})
    scatter.add_scatter(bpy.context.scene, terrain, ScatterSettings(kind="rocks"), 1.0)
    before, _ = places(terrain)
    x = before[:, 0, 3]
    at_foot, on_plain, on_top = (x > -25.0) & (x < -8.0), x < -45.0, x > (25.0 if "debris" in values else 5.0)
    assert at_foot.sum() > 300 and max(on_plain.sum(), on_top.sum()) < 0.02 * at_foot.sum()
    camera.location = (-8.0, 5.0, 20.0)
    after, _ = places(terrain)

    def near_both(matrices):
        return matrices[np.linalg.norm(matrices[:, :2, 3] - [-4.0, 2.5], axis=1) < 0.3 * below.distance]

    assert len(near_both(before)) > 100 and np.allclose(near_both(before), near_both(after), atol=1e-4)


def test_there_is_nothing_right_before_the_camera(terrain, layer, monkeypatch):
    add_camera(-20.0, 0.0)
    closest = []
    for clearance in (0.0, 6.0):
        monkeypatch.setitem(scatter.KINDS, "rocks", {"Stones": replace(layer, clearance=clearance)})
        scatter.add_scatter(bpy.context.scene, terrain, ScatterSettings(kind="rocks"), 1.0)
        closest.append(np.linalg.norm(places(terrain)[0][:, :2, 3] - [-20.0, 0.0], axis=1).min())
    assert closest[0] < 1.5 and 6.0 <= closest[1] < 7.5


@pytest.mark.slow
def test_density_seed_and_height_change_what_there_is(terrain, layer):
    add_camera(-20.0, 0.0)

    def count(**values):
        scatter.add_scatter(bpy.context.scene, terrain, ScatterSettings(kind="rocks", **values), 1.0)
        return places(terrain)[0]

    normal, half, double, other = count(), count(density=0.5), count(density=2.0), count(seed=5)
    assert len(half) == pytest.approx(0.5 * len(normal), rel=0.15) and len(double) == pytest.approx(2.0 * len(normal), rel=0.15)
    assert len(other) == pytest.approx(len(normal), rel=0.15) and not np.allclose(other[0], normal[0])
    (item,) = scatter.find_scatter(terrain)
    set_node_input(item.modifiers[0], "Lowest", -25.0)
    item.update_tag()
    above = places(terrain)[0]
    assert 0 < len(above) < len(other) and above[:, 2, 3].min() > -25.0


@pytest.mark.parametrize(
    "kind", ["meadow", "rocks", *(pytest.param(kind, marks=pytest.mark.exhaustive) for kind in KINDS if kind not in ("meadow", "rocks"))]
)
def test_every_kind_is_there_and_can_be_replaced_and_removed(terrain, kind):
    add_camera(-30.0, 0.0)
    before = {name: len(getattr(bpy.data, name)) for name in ("objects", "meshes", "materials", "collections")}
    for _ in range(2):
        created = scatter.add_scatter(bpy.context.scene, terrain, ScatterSettings(kind=kind, distance=0.2), 1.0)
    assert sorted(item[SCATTER_KEY] for item in scatter.find_scatter(terrain)) == sorted(item[SCATTER_KEY] for item in created)
    matrices, names = places(terrain)
    assert len(matrices) and len(set(names)) > 1
    scatter.remove_scatter(terrain)
    assert before == {name: len(getattr(bpy.data, name)) for name in before}


def test_an_object_of_the_user_in_an_asset_collection_stays(terrain, layer):
    add_camera(-20.0, 0.0)
    scatter.add_scatter(bpy.context.scene, terrain, ScatterSettings(kind="rocks"), 1.0)
    own = bpy.data.objects.new("My Rock", bpy.data.meshes.new("My Rock"))
    next(item for item in bpy.data.collections if item.get(SCATTER_KEY) == "Rock").objects.link(own)
    scatter.remove_scatter(terrain)
    assert "My Rock" in bpy.data.objects and "My Rock" in bpy.data.meshes
    bpy.data.meshes.remove(own.data)


@pytest.mark.parametrize("haze_first", [True, False])
def test_they_have_the_haze_of_the_ground(terrain, layer, haze_first):
    add_camera(-20.0, 0.0)
    materials = {material for item in terrain.ground_objects() for material in item.data.materials}

    def add_haze():
        sky.add_haze([*materials, *scatter.find_materials(terrain)], SkySettings(haze=0.5), 200.0, 0.0)

    if haze_first:
        add_haze()
    scatter.add_scatter(bpy.context.scene, terrain, ScatterSettings(kind="rocks"), 1.0)
    if not haze_first:
        add_haze()
    found = scatter.find_materials(terrain)
    groups = [node for material in [*found, *materials] for node in material.node_tree.nodes if node.type == "GROUP"]
    haze = [node for node in groups if node.node_tree.name.startswith(sky.HAZE_GROUP)]
    assert len(found) == 2 and len(haze) == len({*found, *materials}) and len({node.inputs["Distance"].default_value for node in haze}) == 1


@pytest.mark.parametrize("form", plants.ROCK_FORMS)
def test_rocks_are_closed_and_a_third_in_the_ground(form):
    rock = plants.rock(3, 2, form)
    edges = np.sort(rock.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    corners = rock.vertices[rock.triangles]
    assert (np.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]).sum() > 0.0, "its faces point outwards"
    low, height = rock.vertices[:, 2].min(), np.ptp(rock.vertices[:, 2])
    assert np.ptp(rock.vertices[:, :2], axis=0).max() == pytest.approx(1.0) and -low == pytest.approx(height / 3.0)


def test_forms_of_rocks_differ():
    heights = {form: np.mean([np.ptp(plants.rock(seed, 1, form).vertices[:, 2]) for seed in range(9)]) for form in plants.ROCK_FORMS}
    assert heights["slab"] < 0.35 < 0.6 < heights["block"]
    rubble, rock = plants.rubble(1, 2), plants.rock(1, 2)
    assert len(rubble.triangles) > 1.5 * len(rock.triangles) and np.ptp(rubble.vertices[:, :2], axis=0).max() > 1.2


def test_plants_stand_on_the_ground():
    for model in (plants.grass(1, 30, 0.2, 0.3), plants.bush(1, 200, 1.0, 3), plants.conifer(1, 0.2), plants.broadleaf(1, 300)):
        assert np.isfinite(model.vertices).all() and -1.0 < model.vertices[:, 2].min() < 0.05 < model.vertices[:, 2].max()
        assert model.triangles.max() < len(model.vertices) == len(model.shades) and len(model.materials) == len(model.triangles)


def test_plants_follow_their_seed_and_their_detail():
    assert np.array_equal(plants.conifer(4, 0.2).vertices, plants.conifer(4, 0.2).vertices)
    assert not np.array_equal(plants.bush(4, 99, 1.0).vertices, plants.bush(5, 99, 1.0).vertices)
    assert len(plants.conifer(4, 0.2).triangles) < 0.4 * len(plants.conifer(4, 0.5).triangles)
    high = plants.grass(2, 400, 0.2, 0.6).vertices[:, 2].max() / plants.grass(2, 400, 0.2, 0.3).vertices[:, 2].max()
    assert high == pytest.approx(2.0, rel=0.1)


def test_inputs_of_the_ground_may_be_linked(terrain, layer):
    add_camera(-20.0, 0.0)
    material = next(material for item in terrain.ground_objects() for material in item.data.materials)
    group = next(node for node in material.node_tree.nodes if node.type == "GROUP" and "Snow Height" in node.inputs)
    value = material.node_tree.nodes.new("ShaderNodeValue")
    for name in ("Snow Height", "Water Height", "Grass"):
        material.node_tree.links.new(value.outputs[0], group.inputs[name])
    try:
        assert scatter.add_scatter(bpy.context.scene, terrain, ScatterSettings(kind="meadow"), 1.0)
    finally:
        material.node_tree.nodes.remove(value)


def test_plants_lean_in_the_wind_and_stay_in_place(terrain, layer):
    add_camera(-20.0, 0.0)
    scene, found = bpy.context.scene, {}
    for wind in (0.0, 0.5, 1.0):
        scatter.add_scatter(scene, terrain, ScatterSettings(kind="rocks", wind=wind), 1.0)
        for frame in (1, 30):
            scene.frame_set(frame)
            found[wind, frame] = places(terrain)[0]
    still = found[0.0, 1]
    assert np.array_equal(found[0.0, 30], still) and len(still) > 200
    for wind in (0.5, 1.0):
        first, last = found[wind, 1], found[wind, 30]
        assert np.allclose(first[:, :3, 3], still[:, :3, 3]) and np.allclose(last[:, :3, 3], still[:, :3, 3])
        assert np.abs(first - last).max() > 0.01
        axes, calm = ((matrix[:, :3, 2] / np.linalg.norm(matrix[:, :3, 2], axis=1, keepdims=True)) for matrix in (first, still))
        angles = np.arccos(np.clip((axes * calm).sum(axis=1), -1.0, 1.0))
        assert angles.max() <= 1.2 * wind * layer.sway + 1e-3 and angles.mean() > 0.2 * wind * layer.sway
        assert (axes[:, 0] - calm[:, 0]).mean() > 0.0, "they lean along X"


def test_ground_without_a_collection_of_its_own_is_refused(terrain, layer):
    add_camera(-20.0, 0.0)
    scene = bpy.context.scene
    (collection,) = terrain.root.users_collection
    for item in terrain.ground_objects():
        scene.collection.objects.link(item)
        collection.objects.unlink(item)
    try:
        with pytest.raises(GeometryError, match="into a collection of its own"):
            scatter.add_scatter(scene, terrain, ScatterSettings(kind="rocks"), 1.0)
    finally:
        for item in terrain.ground_objects():
            collection.objects.link(item)
            scene.collection.objects.unlink(item)
