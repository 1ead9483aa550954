"""Small scenes for the operators of the tool `billboards`, and what the tests ask about them."""

import bpy

ROUGH = {"error": 5.0, "levels": 2, "nested_levels": True, "textures": False}


def build(**arguments):
    """Build with few quads and without textures by default."""
    return bpy.ops.farfield.billboards_build(**(ROUGH | arguments))


def cube(name="Cube", location=(0.0, 0.0, 0.0), **arguments):
    """Add a selected cube with side 2."""
    bpy.ops.mesh.primitive_cube_add(location=location, **arguments)
    bpy.context.object.name = name
    return bpy.context.object


def select(*objects):
    """Select exactly these objects."""
    bpy.context.view_layer.update()
    for item in bpy.context.view_layer.objects:
        item.select_set(item in objects)
    bpy.context.view_layer.objects.active = objects[0] if objects else None


def levels():
    """Return the level objects in the file, by name."""
    return {item.name: item for item in bpy.data.objects if item.get("farfield_kind") == "cloud"}


def is_hidden(item):
    """Return whether an object, or its cloud's collection, is hidden in the viewport and in renders; the two must agree."""
    holders = [item, *(collection for collection in item.users_collection if collection != bpy.context.scene.collection)]
    in_viewport, in_render = any(holder.hide_viewport for holder in holders), any(holder.hide_render for holder in holders)
    assert in_viewport == in_render
    return in_viewport


def link_from_library(path, name="Linked"):
    """Save a file with a cube, open an empty one, and link the cube into it; returns the linked object, selected."""
    cube(name)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(path), link=True) as (_, target):
        target.objects = [name]
    bpy.context.collection.objects.link(target.objects[0])
    select(target.objects[0])
    return target.objects[0]
