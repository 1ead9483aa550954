"""Objects that are put on the ground of clip-box terrain."""

import bpy
import mathutils
import numpy as np
import pytest

from farfield.addon.bridge.clipbox.objects import SceneTerrain

pytestmark = pytest.mark.usefixtures("empty_scene")
FORMULA = "max(-z, 5 - abs(z - 25))"  # Ground, and rock from 20 to 30 above it.


def add_empties(*positions):
    """Select new empties at positions in world space."""
    items = []
    for position in positions:
        item = bpy.data.objects.new("Empty", None)
        item.location = position
        bpy.context.scene.collection.objects.link(item)
        item.select_set(True)
        items.append(item)
    bpy.context.view_layer.update()
    return items


def test_objects_fall_on_the_ground_below_them_also_where_the_terrain_is_turned():
    bpy.ops.farfield.clipbox_create(terrain="formula", formula=FORMULA, boxes=2, resolution=64)
    (terrain,) = SceneTerrain.in_scene(bpy.context.scene)
    matrix = mathutils.Matrix.LocRotScale((40.0, -70.0, 25.0), mathutils.Euler((0.3, -0.2, 0.8)), (2.0, 2.0, 2.0))
    terrain.root.matrix_world = matrix @ terrain.root.matrix_world
    bpy.context.view_layer.update()
    bpy.ops.object.select_all(action="DESELECT")
    starts = [(3.3, -5.1, 90.0), (10.2, 4.4, 26.0), (-7.5, 2.0, 11.0), (0.7, 0.1, -3.0)]
    items = add_empties(*(matrix @ mathutils.Vector(start) for start in starts))
    assert bpy.ops.farfield.clipbox_drop(offset=0.5) == {"FINISHED"}
    bpy.context.view_layer.update()
    found = np.array([matrix.inverted() @ item.matrix_world.translation for item in items])
    expected = [[*start[:2], height + 0.25] for start, height in zip(starts, (30.0, 30.0, 0.0, 0.0), strict=True)]
    assert np.allclose(found, expected, atol=2e-3)


def test_what_keeps_objects_in_place_is_explained(capsys):
    add_empties((0.0, 0.0, 5.0))
    with pytest.raises(RuntimeError, match="Add a clip-box terrain first"):
        bpy.ops.farfield.clipbox_drop()
    bpy.ops.farfield.clipbox_create(terrain="formula", formula="-z", boxes=2, resolution=64)
    bpy.ops.object.select_all(action="DESELECT")
    near, far = add_empties((0.0, 0.0, 5.0), (1e5, 0.0, 5.0))
    bpy.ops.farfield.clipbox_drop()
    assert "Put 1 object on the ground. Skipped 1 object: outside of the terrain or over holes." in capsys.readouterr().out
    assert near.location.z == pytest.approx(0.0, abs=2e-3) and far.location.z == 5.0
