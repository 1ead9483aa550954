"""Terrains linked from another file, overridden, or in an asset library: Blender crashes when linked meshes are changed, so none is."""

import json
import re
import subprocess
import sys

import pytest

from lib import environment

# In a process of its own: a crash is a failure of the test, not of the run.
SESSION = """
import json, sys
sys.path[:0] = sys.argv[1:3]
from lib import environment
package = environment.import_farfield()
import bpy
package.register()
from farfield.addon.bridge.clipbox import objects as terrain_objects
from scene_terrain import camera_at, create
NAME = "Clip-Box Terrain"

def fly(start):
    for step in range(4):
        bpy.context.scene.camera.location.x = 200.0 * step
        bpy.context.view_layer.update()
        bpy.context.scene.frame_set(start + step)

def geometry():
    return [(mesh.library is not None, len(mesh.polygons), mesh.users > 0) for mesh in bpy.data.meshes if mesh.library is not None]

def run(results, linked, name, operator, **settings):
    bpy.context.view_layer.objects.active = linked.root
    try:
        results[name] = list(operator(**settings))
    except RuntimeError as error:
        results[name] = str(error)

bpy.ops.wm.read_factory_settings(use_empty=True)
camera_at(0.0, 0.0, 20.0)
root = create().root
root.farfield_clipbox_follow_camera = True
bpy.data.collections[NAME].asset_mark()
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[3])

def record(kind):
    results = {}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    camera_at(0.0, 0.0, 20.0)
    scene = bpy.context.scene
    loading = {"assets_only": True} if kind == "asset" else {}
    with bpy.data.libraries.load(sys.argv[3], link=True, **loading) as (found, wanted):
        wanted.collections = [NAME]
    [collection] = wanted.collections
    scene.collection.children.link(collection)
    if kind == "override":
        collection.override_hierarchy_create(scene, bpy.context.view_layer, do_fully_editable=True)
        if collection in scene.collection.children.values():
            scene.collection.children.unlink(collection)
    if kind == "linked meshes":
        collection = collection.make_local()
        for item in list(collection.all_objects):
            item.make_local()
        assert all(item.data.library is not None for item in collection.all_objects if item.type == "MESH")
    linked = terrain_objects.SceneTerrain.in_scene(scene)[0]
    results["reason"], before = linked.read_only_reason, geometry()
    fly(5)
    operators = bpy.ops.farfield
    run(results, linked, "update", operators.clipbox_update, boxes=2, resolution=32)
    fly(15)
    run(results, linked, "follow", operators.clipbox_follow_view)
    run(results, linked, "convert", operators.clipbox_convert_to_mesh, collider=False)
    run(results, linked, "convert and keep", operators.clipbox_convert_to_mesh, collider=False, keep_terrain=True)
    run(results, linked, "create", operators.clipbox_create, boxes=2, resolution=32)
    fly(25)
    results["unchanged"] = geometry() == before
    results["own terrains"] = sum(not terrain.read_only_reason for terrain in terrain_objects.SceneTerrain.in_scene(scene))
    results["converted"] = len(bpy.data.collections["Terrain Mesh"].objects) if "Terrain Mesh" in bpy.data.collections else 0
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.object.make_local(type="ALL")
    results["reasons when local"] = [terrain.read_only_reason for terrain in terrain_objects.SceneTerrain.in_scene(scene)]
    fly(35)
    print(f"RESULTS {kind}: {json.dumps(results)}", file=sys.stderr, flush=True)

for kind in sys.argv[4:]:
    record(kind)
package.unregister()
import os
os._exit(0)
"""


KINDS = {"linked": "is linked from another file", "asset": "is linked from another file", "override": "is a library override"}
LINKED_MESHES = "linked meshes"


@pytest.fixture(scope="module")
def sessions(tmp_path_factory) -> dict[str, tuple[dict, str]]:
    """The results of the session by kind, and its messages: one process runs all kinds."""
    library = tmp_path_factory.mktemp("library") / "library.blend"
    arguments = [str(environment.ROOT / "scripts"), str(environment.ROOT / "tests"), str(library), *KINDS, LINKED_MESHES]
    outcome = subprocess.run([sys.executable, "-c", SESSION, *arguments], capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    assert "Traceback" not in outcome.stderr
    messages, *ends = re.split("^RESULTS ", outcome.stderr, flags=re.MULTILINE)
    sessions = {}
    for end in ends:
        line, _, following = end.partition("\n")
        kind, _, results = line.partition(": ")
        sessions[kind], messages = (json.loads(results), messages), following
    return sessions


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "reason"), KINDS.items())
def test_terrains_of_other_files_are_rejected_and_stay_unchanged(sessions, kind, reason):
    results, messages = sessions[kind]
    sentence = f'The terrain "Clip-Box Terrain" {reason}; make it local'
    assert results["reason"].startswith(sentence)
    assert messages.count(f"{results['reason']}.\n") == 1, "frames print the reason once"
    for name in ("update", "follow", "convert"):
        assert sentence in results[name], name
    assert "enable Keep Terrain" in results["convert"]
    assert results["convert and keep"] == results["create"] == ["FINISHED"] and results["converted"] == 1
    assert results["unchanged"] and results["own terrains"] == 1
    assert results["reasons when local"] == ["", ""]


@pytest.mark.slow
def test_a_local_terrain_with_linked_meshes_gets_meshes_of_its_own(sessions):
    results, _ = sessions[LINKED_MESHES]
    assert results["reason"] == "" and results["update"] == results["follow"] == results["create"] == ["FINISHED"]
