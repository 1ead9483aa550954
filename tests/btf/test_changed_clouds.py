"""A cloud is baked as it was built, wherever it is now. What cannot be baked is rejected in one sentence, before anything is changed."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy
import mathutils

from bridge import blender_scenes
from bridge.bakes import (
    SMALL,
    bake_finished_views,
    build_small_cloud,
    copy_finished_views,
    finished_views_of_small_cloud,
    open_cloud,
    prepare_job,
)
from farfield.addon.bridge.billboards import clouds
from farfield.addon.bridge.billboards.cloud_materials import FRONT_COLOR
from farfield.addon.bridge.billboards.level_objects import CENTER, PBR_MATERIAL, pbr_image, pbr_material
from farfield.addon.bridge.billboards.scene_clouds import SceneCloud, clouds_in
from farfield.addon.bridge.btf.levels.decode import read_relightable_texture
from farfield.addon.bridge.btf.levels.emission_levels import link_suns
from farfield.addon.bridge.btf.materials.emission_material import AMBIENT, sun_color_property, sun_direction_property
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.btf.job import BakeJob
from farfield.addon.operators.btf.operators import disabled_reason
from lib import scene_files

BAKE = {**SMALL, "executor": "serial"}


@pytest.fixture(scope="module")
def cloud_file(extension, tmp_path_factory) -> Path:
    """A file with a ball and its cloud with two levels; the origin of the ball is not at its center."""
    blender_scenes.reset_scene()
    cloud = build_small_cloud()
    bpy.context.view_layer.objects.active = cloud.levels[0]
    path = tmp_path_factory.mktemp("cloud") / "cloud.blend"
    scene_files.save_scene(path)
    return path


@pytest.fixture
def cloud(cloud_file) -> SceneCloud:
    return open_cloud(cloud_file)


@pytest.fixture(scope="module")
def finished_views(extension) -> None:
    """All views that these tests bake; capturing them opens other files."""
    for model in ("emission", "surface"):
        finished_views_of_small_cloud(model)


@pytest.fixture(scope="module")
def baked(cloud_file, tmp_path_factory) -> list:
    """What the work in the core has computed for the cloud."""
    work = copy_finished_views(tmp_path_factory.mktemp("work"))
    return run_to_end(prepare_job(open_cloud(cloud_file), work).core_steps())


@pytest.fixture(scope="module")
def baked_file(baked, cloud_file, tmp_path_factory) -> Path:
    """A file with the cloud, baked by the operator with its first level active."""
    bake_finished_views(open_cloud(cloud_file))
    path = tmp_path_factory.mktemp("baked") / "baked.blend"
    scene_files.save_scene(path)
    return path


def captured(job: BakeJob) -> list[np.ndarray]:
    """Return everything of the levels of a job that depends on where they are."""
    return [
        values
        for level in job.levels
        for values in (level.spec.texels.positions, level.spec.texels.steps, level.spec.texels.pixels, *level.quads.corners)
    ]


class TestMovedClouds:
    """The capture does not depend on where the cloud is."""

    @pytest.mark.slow
    def test_moved_rotated_scaled_and_parented_levels(self, cloud, tmp_path):
        expected = captured(prepare_job(cloud, tmp_path / "a"))
        parent = bpy.data.objects.new("Parent", None)
        bpy.context.scene.collection.objects.link(parent)
        parent.location = (5.0, -2.0, 1.0)
        cloud.levels[0].parent = parent
        level = cloud.levels[1]
        level.location, level.rotation_euler, level.scale = (0.0, 0.3, 7.0), (0.0, 0.0, 0.5), (0.5, 2.0, -1.0)
        bpy.context.view_layer.update()
        for before, after in zip(expected, captured(prepare_job(cloud, tmp_path / "b")), strict=True):
            np.testing.assert_array_equal(after, before)

    @pytest.mark.slow
    def test_an_applied_location(self, cloud, tmp_path):
        """Blender moves the vertices then."""
        expected = captured(prepare_job(cloud, tmp_path / "a"))
        for level in cloud.levels:
            level.hide_viewport = False
            level.location.x += 3.0
            with bpy.context.temp_override(active_object=level, object=level, selected_editable_objects=[level]):
                bpy.ops.object.transform_apply(location=True)
            assert np.array(level.matrix_world.translation).max() == 0.0
        for before, after in zip(expected, captured(prepare_job(cloud, tmp_path / "b")), strict=True):
            np.testing.assert_allclose(after, before, atol=1e-5)

    @pytest.mark.slow
    @pytest.mark.parametrize("stored", [None, "text", [1, 2], {"a": 1}])
    def test_clouds_that_do_not_tell_where_they_were_built(self, cloud, tmp_path, stored):
        expected = captured(prepare_job(cloud, tmp_path / "a"))
        for level in cloud.levels:
            del level[CENTER]
            if stored is not None:
                level[CENTER] = stored
            level.location.x += 3.0
        for before, after in zip(expected, captured(prepare_job(cloud, tmp_path / "b")), strict=True):
            np.testing.assert_allclose(after, before, atol=1e-6)


def scale_uvs(level: bpy.types.Object) -> None:
    for uv in level.data.uv_layers[0].uv:
        uv.vector *= 1e4


def overlap_uvs(level: bpy.types.Object) -> None:
    for polygon in level.data.polygons:
        for loop, uv in zip(
            polygon.loop_indices, ((0, 0), (1, 0), (1, 1), (0, 1), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5), (0, 0)), strict=False
        ):
            level.data.uv_layers[0].uv[loop].vector = uv


def move_vertex(level: bpy.types.Object, value: float) -> None:
    level.data.vertices[0].co.x = value


def resize_image(level: bpy.types.Object) -> None:
    node = next(node for node in level.data.materials[0].node_tree.nodes if node.type == "TEX_IMAGE" and node.label == "Front normal")
    node.image.scale(7, 7)


def damage_image(level: bpy.types.Object) -> None:
    blender_scenes.damage_packed_image(pbr_image(level, "Front normal"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda level: level.__setitem__("farfield_atlas", [10**6, 10**6]), "size of its atlas"),
        (lambda level: level.__setitem__("farfield_atlas", [64.0, 64.0]), "size of its atlas"),
        (lambda level: level.__setitem__("farfield_atlas", "large"), "size of its atlas"),
        (lambda level: level.__setitem__("farfield_atlas", 64), "size of its atlas"),
        (lambda level: level.__setitem__("farfield_error", 0.0), "its error is not a positive number"),
        (lambda level: level.data.__setitem__("farfield_drawn", "all"), "which faces of the source"),
        (lambda level: level.data.__setitem__("farfield_drawn", [-1] * len(level.data["farfield_drawn"])), "which faces of the source"),
        (lambda level: level.data.__setitem__("farfield_drawn", [10**9] * len(level.data["farfield_drawn"])), "which faces of the source"),
        (lambda level: level.data.__setitem__("farfield_drawn_offsets", [0, 1]), "which faces of the source"),
        (lambda level: level.data.__delitem__("farfield_drawn_offsets"), "which faces of the source"),
        (scale_uvs, "its UV map leaves the atlas"),
        (overlap_uvs, "its quads overlap in the UV map"),
        (lambda level: level.data.uv_layers.remove(level.data.uv_layers[0]), "it has no UV map"),
        (lambda level: move_vertex(level, float("nan")), "its vertices are not finite"),
        (lambda level: move_vertex(level, 50.0), "its vertices were edited"),
        (lambda level: level.data.transform(mathutils.Matrix.Rotation(3.0, 4, "X")), "its quads are not on the source"),
        (lambda level: level.data.transform(mathutils.Matrix.Scale(4.0, 4)), "its quads are not on the source"),
        (lambda level: level.data.clear_geometry(), "it has no quads"),
        (lambda level: level.data.materials.clear(), "its material slot was removed"),
        (resize_image, "its images have another size"),
        (damage_image, 'its image "Ball Cloud L1 Front Normal" cannot be read'),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_changed_levels_are_rejected(cloud, tmp_path, change: Callable[[bpy.types.Object], None], message):
    change(cloud.levels[1])
    with pytest.raises(GeometryError, match=f'"Ball Cloud L1" was changed after the cloud was built: .*{message}.*Rebuild the cloud'):
        prepare_job(cloud, tmp_path / "work")
    assert not (tmp_path / "work").exists()


def edit(level: bpy.types.Object) -> None:
    """Switch to Edit Mode. Blender enters it for visible objects only."""
    level.hide_viewport = False
    bpy.context.view_layer.objects.active = level
    bpy.ops.object.mode_set(mode="EDIT")


def count_data() -> list[int]:
    return [len(blocks) for blocks in (bpy.data.images, bpy.data.materials, bpy.data.node_groups, bpy.data.objects, bpy.data.meshes)]


class TestEditMode:
    """Blender keeps the quads of a level in Edit Mode elsewhere."""

    @pytest.mark.slow
    def test_a_bake_is_refused(self, cloud, tmp_path):
        edit(cloud.levels[1])
        before = count_data()
        with pytest.raises(RuntimeError, match='"Ball Cloud L1" is in Edit Mode; switch to Object Mode first') as refusal:
            bpy.ops.farfield.btf_bake(**BAKE)
        assert "defect" not in str(refusal.value) and count_data() == before
        bpy.ops.object.mode_set(mode="OBJECT")
        prepare_job(cloud, tmp_path)

    @pytest.mark.slow
    def test_a_finished_bake_is_kept_until_edit_mode_ends(self, baked, cloud, tmp_path):
        job = prepare_job(cloud, tmp_path)
        edit(cloud.levels[1])
        with pytest.raises(GeometryError, match="is in Edit Mode"):
            run_to_end(job.scene_steps(baked))
        assert all(PBR_MATERIAL not in level for level in cloud.levels)
        bpy.ops.object.mode_set(mode="OBJECT")
        run_to_end(job.scene_steps(baked))
        assert all(PBR_MATERIAL in level for level in cloud.levels)


class TestLinkedDuplicates:
    """A level and its linked duplicate share the mesh, and thus the material."""

    @pytest.mark.slow
    def test_both_are_baked_again_and_restored(self, finished_views, baked_file):
        """A bake replaces that of the other model."""
        cloud = open_cloud(baked_file)
        level, duplicate = cloud.levels[0], cloud.levels[0].copy()
        cloud.collection.objects.link(duplicate)
        assert len(clouds_in(bpy.context.scene)[0].levels) == 3
        pbr_name = level[PBR_MATERIAL]
        assert AMBIENT in level, "the model is Emission"
        for model in ("surface", "emission"):
            bake_finished_views(cloud, model)
            assert level[PBR_MATERIAL] == duplicate[PBR_MATERIAL] == pbr_name
            assert level.data.materials[0].name != pbr_name and not level.data.materials[0].name.endswith("BTF BTF")
            assert (AMBIENT in level) == (sun_color_property(0) in level) == (model == "emission")
            assert model == "surface" or read_relightable_texture(level).size == tuple(level["farfield_atlas"])
        assert bpy.ops.farfield.btf_restore_pbr() == {"FINISHED"}
        assert level.data.materials[0].name == pbr_name
        assert all(PBR_MATERIAL not in item and AMBIENT not in item for item in (*cloud.levels, duplicate))

    @pytest.mark.slow
    def test_a_duplicate_outside_of_the_cloud_is_restored_too(self, finished_views, cloud):
        level, duplicate = cloud.levels[0], cloud.levels[0].copy()
        bpy.context.scene.collection.objects.link(duplicate)
        pbr_name = level.data.materials[0].name
        bake_finished_views(cloud, "surface")
        assert duplicate[PBR_MATERIAL] == pbr_name
        bpy.ops.farfield.btf_restore_pbr()
        assert PBR_MATERIAL not in duplicate and duplicate.data.materials[0].name == pbr_name


@pytest.mark.slow
def test_the_model_emission_needs_no_color_map(baked, cloud):
    bpy.data.images.remove(pbr_image(cloud.levels[0], FRONT_COLOR))
    bake_finished_views(cloud)


@pytest.mark.slow
def test_suns_are_linked_where_their_properties_were_deleted(baked_file):
    level = open_cloud(baked_file).levels[0]
    del level[sun_direction_property(0)], level[sun_color_property(0)]
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    bpy.context.scene.collection.objects.link(sun)
    link_suns(level, [sun], (0.0, 0.0, 0.0))
    assert len(level.animation_data.drivers) == 6


@pytest.mark.slow
@pytest.mark.parametrize("value", [float("nan"), "large"])
def test_errors_that_are_not_numbers_are_rejected(cloud, tmp_path, value):
    """By the reader of the cloud or by the bake."""
    cloud.levels[1]["farfield_error"] = value
    with pytest.raises(GeometryError):
        prepare_job(cloud, tmp_path / "work")


class TestChangesDuringABake:
    """While worker processes render, the user may do anything."""

    @pytest.mark.slow
    def test_renamed_data_is_found(self, baked, cloud, tmp_path):
        job = prepare_job(cloud, tmp_path)
        scene, source = bpy.context.scene, cloud.sources[0]
        scene.name, cloud.collection.name, source.name = "Another Scene", "Another Collection", "Another Source"
        source.data.materials[0].name = "Another Material"
        for level in cloud.levels:
            level.name, level.data.name, level.data.materials[0].name = "Another Level", "Another Mesh", "Another PBR"
        cloud.levels[1].location.x += 4.0
        assert "Another" not in run_to_end(job.scene_steps(baked))
        assert all(level[PBR_MATERIAL].startswith("Another PBR") for level in cloud.levels)

    @pytest.mark.slow
    def test_removed_sources_are_not_needed(self, baked, cloud, tmp_path):
        job = prepare_job(cloud, tmp_path)
        bpy.data.materials.remove(cloud.sources[0].data.materials[0])
        bpy.data.objects.remove(cloud.sources[0])
        run_to_end(job.scene_steps(baked))
        assert all(PBR_MATERIAL in level for level in cloud.levels)

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda level: bpy.data.objects.remove(level), "was rebuilt while it was being baked"),
            (lambda level: bpy.data.materials.remove(pbr_material(level)), '"Ball Cloud L1" was changed while it was being baked'),
            (lambda level: level.data.materials.clear(), "was changed while it was being baked"),
            (lambda level: move_vertex(level, 9.0), "was changed while it was being baked"),
            (lambda level: level.data.clear_geometry(), "was changed while it was being baked"),
        ],
        ids=["level", "material", "slot", "vertex", "geometry"],
    )
    def test_a_changed_level_is_rejected_before_another_is_assigned(self, cloud, tmp_path, change, message):
        job = prepare_job(cloud, tmp_path)
        change(cloud.levels[1])
        with pytest.raises(GeometryError, match=message):
            run_to_end(job.scene_steps([]))
        assert PBR_MATERIAL not in cloud.levels[0]


class TestLinkedClouds:
    """Textures of linked data would not be saved with the file."""

    def link(self, cloud_file: Path, *, override: bool) -> SceneCloud:
        blender_scenes.reset_scene()
        with bpy.data.libraries.load(str(cloud_file), link=True) as (_, linked):
            linked.collections, linked.objects = ["Ball Cloud"], ["Ball"]
        bpy.context.scene.collection.objects.link(linked.objects[0])
        collection = linked.collections[0]
        if override:
            collection = collection.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer)
        else:
            bpy.context.scene.collection.children.link(collection)
        (cloud,) = (found for found in clouds_in(bpy.context.scene) if found.collection == collection)
        return cloud

    @pytest.mark.slow
    @pytest.mark.parametrize("override", [False, True])
    def test_a_linked_cloud_is_rejected(self, cloud_file, tmp_path, override):
        cloud = self.link(cloud_file, override=override)
        with pytest.raises(GeometryError, match=r"is linked from another file.*local first"):
            prepare_job(cloud, tmp_path)
        bpy.context.view_layer.objects.active = cloud.levels[0]
        with pytest.raises(RuntimeError, match="linked from another file"):
            bpy.ops.farfield.btf_bake(**BAKE)

    @pytest.mark.slow
    def test_suns_are_not_linked_to_a_linked_cloud(self, baked_file):
        linked = self.link(baked_file, override=False)
        bpy.context.view_layer.objects.active = linked.levels[0]
        for operator in (bpy.ops.farfield.btf_link_suns, bpy.ops.farfield.btf_restore_pbr):
            assert not operator.poll()
        assert bpy.ops.farfield.btf_export.poll()


@pytest.mark.slow
def test_an_ordinary_mesh_needs_a_cloud_first(cloud):
    bpy.ops.mesh.primitive_cube_add()
    assert disabled_reason(bpy.context) == "Build a billboard cloud first, or select one or its original"
    bpy.context.view_layer.objects.active = cloud.levels[0]
    assert disabled_reason(bpy.context) == ""


@pytest.mark.slow
def test_a_cloud_without_drawn_faces_is_of_an_older_version(cloud, tmp_path):
    for level in cloud.levels:
        del level.data[clouds.DRAWN]
    with pytest.raises(GeometryError, match="older version"):
        prepare_job(cloud, tmp_path)
