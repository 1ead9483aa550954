"""Files render without Farfield and with *Auto Run Python Scripts* off, as on most render farms."""

import json
import subprocess
import sys

import pytest

bpy = pytest.importorskip("bpy")

from farfield.addon.bridge.btf.levels import emission_levels as btf_clouds  # noqa: E402
from farfield.addon.bridge.btf.materials.emission_material import AMBIENT, SUNS, sun_color_property, sun_direction_property  # noqa: E402
from farfield.addon.bridge.lod_crossfade import CAMERA_POSITION  # noqa: E402 - only where bpy is
from farfield.addon.compat import enable_nodes  # noqa: E402

PROBE = """
import json, sys
import bpy

bpy.context.preferences.filepaths.use_scripts_auto_execute = False
bpy.ops.wm.open_mainfile(filepath=sys.argv[1], use_scripts=False)
assert not bpy.app.autoexec_fail, bpy.app.autoexec_fail_message

def drivers():
    return [curve.driver for item in bpy.data.objects if item.animation_data for curve in item.animation_data.drivers]

def values():
    return {item.name: {key: list(value) for key, value in item.items() if hasattr(value, "__len__") and key.startswith("farfield_")
            and not isinstance(value, str)} for item in bpy.data.objects}

before = values()
bpy.data.objects["Camera"].location.y -= 30.0
bpy.data.objects["Sun"].rotation_euler.x += 1.0
bpy.data.lights["Sun"].energy *= 2.0
bpy.context.view_layer.update()
after = values()
changed = sorted({key for name in before for key in before[name] if before[name][key] != after[name][key]})
print("PROBE" + json.dumps({
    "farfield": any("farfield" in name for name in sys.modules),
    "drivers": len(drivers()),
    "simple": all(driver.is_simple_expression or driver.type != "SCRIPTED" for driver in drivers()),
    "valid": all(driver.is_valid for driver in drivers()),
    "texts": len(bpy.data.texts),
    "changed": changed,
}))
"""


@pytest.fixture
def saved_scene(empty_scene, tmp_path):
    """A file with a cloud that cross-fades for a camera and has a linked Sun light."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    for item in (camera, sun):
        empty_scene.collection.objects.link(item)
    camera.location = (0.0, -40.0, 0.0)
    empty_scene.camera = camera
    bpy.ops.mesh.primitive_uv_sphere_add(segments=16, ring_count=8)
    assert bpy.ops.farfield.billboards_build(error=5.0, levels=2, nested_levels=True, textures=False) == {"FINISHED"}
    assert bpy.ops.farfield.billboards_crossfade() == {"FINISHED"}
    level = bpy.data.objects["Sphere Cloud L0"]
    for index in range(SUNS):
        level[sun_direction_property(index)] = [0.0, 0.0, 1.0]
        level[sun_color_property(index)] = [0.0, 0.0, 0.0]
    level[AMBIENT] = [0.0, 0.0, 0.0]
    level.data.materials[0] = bpy.data.materials.new("Relightable")
    enable_nodes(level.data.materials[0])
    btf_clouds.link_suns(level, [sun], (0.1, 0.1, 0.1))
    path = tmp_path / "farm.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.mark.slow
def test_drivers_follow_with_scripts_disabled(saved_scene):
    outcome = subprocess.run([sys.executable, "-c", PROBE, str(saved_scene)], capture_output=True, text=True, check=False)
    lines = [line for line in outcome.stdout.splitlines() if line.startswith("PROBE")]
    assert lines, outcome.stderr
    found = json.loads(lines[0].removeprefix("PROBE"))
    assert not found["farfield"] and found["texts"] == 0
    assert found["drivers"] >= 6 and found["simple"] and found["valid"]
    assert {sun_direction_property(0), sun_color_property(0), CAMERA_POSITION} <= set(found["changed"])
