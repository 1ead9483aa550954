"""Runs inside pip's bpy: enables the installed zip twice, uses it, and prints what it saw as one JSON line."""

import json
import sys

import bpy

MODULE = "bl_ext.user_default.farfield"


def classes() -> list[str]:
    """Names of the classes of the extension that Blender knows now."""
    return sorted(name for name in dir(bpy.types) if name.startswith("FARFIELD_"))


def passes_on(error: Exception) -> None:
    """Blender prints errors of an extension and goes on; here they must end the run."""
    raise error


def tab(names: list[str]) -> set[str]:
    """The sidebar tabs that the panels among `names` stand in."""
    return {getattr(bpy.types, name).bl_category for name in names if "_PT_" in name}


def main() -> None:
    """Enable and disable twice; while enabled the second time, build a cloud of a cube and bake it."""
    import addon_utils  # stands only where bpy has been imported

    addon_utils.extensions_refresh(addon_modules_pending=[MODULE])
    seen = {"enabled": [], "disabled": [], "tabs": []}
    for turn in range(2):
        addon_utils.enable(MODULE, default_set=True, handle_error=passes_on)
        seen["enabled"].append(classes())
        seen["tabs"].append(sorted(tab(classes())))
        if turn == 1:
            bpy.ops.mesh.primitive_cube_add()
            bpy.ops.farfield.billboards_build(error=10.0, samples=1, levels=1)
            seen["clouds"] = sum(item.get("farfield_kind") == "cloud" for item in bpy.data.objects)
            bpy.ops.farfield.btf_bake(views=4, lights=4, samples=1, components=1, alpha_components=1, shadows=16, executor="processes:2")
            seen["baked"] = [item.data.materials[0].name for item in bpy.data.objects if item.get("farfield_kind") == "cloud"]
        addon_utils.disable(MODULE, default_set=True, handle_error=passes_on)
        seen["disabled"].append(classes())
    brought = ("scipy", "xatlas", "fast_simplification", "threadpoolctl", "tifffile")
    seen["wheels"] = {name: sys.modules[name].__file__ for name in brought if name in sys.modules}
    print("SEEN " + json.dumps(seen))


main()
