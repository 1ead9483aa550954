"""The scripts in docs/tutorial.md run one after the other, here with small sizes, and do what the page says."""

import re

import bpy
import pytest

from lib import environment

PAGE = (environment.ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
STEPS = dict(re.findall(r"```python\n# ([^\n]*)\n(.*?)```", PAGE, re.DOTALL))
pytestmark = pytest.mark.filterwarnings("ignore:.*use_nodes:DeprecationWarning")  # which Blender 4.5 needs
SMALL = {  # assignments of sizes -> values with which the page runs in seconds
    "branches": "24",
    "subdivisions, pixels": "2, 64",
    "views, largest": "2, 64",
    "copies": "12",
    "width, samples": "32, 1",
}


def run(step: str, sizes: dict[str, str]) -> None:
    """Run a script of the page as Blender's Text Editor does: in a namespace of its own."""
    code = STEPS[step]
    for names, values in sizes.items():
        code = re.sub(rf"^{names} = .*$", f"{names} = {values}", code, flags=re.MULTILINE)
    exec(compile(code, f"tutorial.md, {step}", "exec"), {})


@pytest.fixture(scope="module")
def renders(extension, few_samples, coarse_packing):
    """The scene after all steps. Returns the scenes that were rendered."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    finished = []
    for step in STEPS:
        if step == "step 5: the render":
            bpy.app.handlers.render_complete.append(lambda scene, *_: finished.append(scene.name))
        run(step, SMALL)
    bpy.app.handlers.render_complete.clear()
    return finished


def test_every_script_is_run_with_sizes_that_it_has():
    assert PAGE.count("```python") == len(STEPS)
    assert [int(step.split(":")[0].removeprefix("step ")) for step in STEPS] == [1, 2, 2, 3, 3, 4, 5]
    assert all(re.search(rf"^{names} = ", PAGE, re.MULTILINE) for names in SMALL)


def test_the_pine_has_the_triangles_that_the_page_names(empty_scene):
    run("step 2: a pine", {})
    mesh = bpy.data.objects["Pine"].data
    assert f"a pine of {len(mesh.polygons):,} triangles" in PAGE
    assert {polygon.material_index for polygon in mesh.polygons} == {0, 1}


@pytest.mark.usefixtures("renders")
class TestScene:
    """What is in the scene after all steps."""

    @pytest.mark.slow
    def test_the_ground_follows_the_camera_and_touches_the_pine(self):
        (root,) = (item for item in bpy.data.objects if item.farfield_clipbox_follow_camera)
        heights = [(block.matrix_world @ vertex.co) for block in root.children for vertex in block.data.vertices]
        assert min(heights, key=lambda point: point.xy.length).z == pytest.approx(0.0, abs=0.3)

    @pytest.mark.slow
    def test_the_cloud_of_the_pine_has_levels_and_cross_fades(self):
        items = bpy.data.collections["Pine Cloud"].objects
        quads = [item["farfield_quads"] for item in items if item["farfield_kind"] == "cloud"]
        assert len(quads) >= 2 and quads == sorted(quads, reverse=True)
        assert all("farfield_crossfade" in item for item in items) and bpy.data.objects["Pine"].hide_render

    @pytest.mark.slow
    def test_the_rock_has_a_uv_map_an_image_and_coarser_levels(self):
        rock = bpy.data.objects["Rock"]
        assert [layer.name for layer in rock.data.uv_layers] == ["Unwrap"]
        assert len({round(value, 2) for value in bpy.data.images["Stone"].pixels}) > 10
        triangles = [len(level.data.polygons) for level in bpy.data.collections["Rock Levels"].objects]
        assert triangles[0] == len(rock.data.polygons) and triangles == sorted(set(triangles), reverse=True) and len(triangles) > 1

    @pytest.mark.slow
    def test_the_forest_leaves_a_clearing(self):
        copies = [item for item in bpy.data.objects if item.instance_type == "COLLECTION"]
        assert {item.instance_collection.name for item in copies} == {"Pine Cloud", "Rock Levels"}
        assert len(copies) == int(SMALL["copies"]) and all(abs(item.location.x) > 9.0 for item in copies)

    @pytest.mark.slow
    def test_the_scene_is_rendered(self, renders):
        assert renders == [bpy.context.scene.name]
