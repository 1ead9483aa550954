"""World matrices of objects that may be hidden."""

import bpy
import mathutils


def world_matrix(item: bpy.types.Object) -> mathutils.Matrix:
    """Return the world matrix of an object. Blender does not compute `matrix_world` of objects that are hidden in an opened file."""
    return item.matrix_basis if item.parent is None and not item.constraints else item.matrix_world
