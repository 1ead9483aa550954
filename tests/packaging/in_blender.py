"""Runs inside pip's bpy: enables the installed zip twice, uses it, and prints the results as one JSON line."""

import json
import sys
from pathlib import Path

import bpy

MODULE = "bl_ext.user_default.farfield"


def registered_classes() -> list[str]:
    """Return the names of the extension's registered classes."""
    return sorted(name for name in dir(bpy.types) if name.startswith("FARFIELD_"))


def raise_error(error: Exception) -> None:
    """Raise errors of the extension, which Blender would print and ignore."""
    raise error


def sidebar_tabs(names: list[str]) -> set[str]:
    """Return the sidebar tabs of the panels among `names`. Those of presets open from headers, and have none."""
    panels = [getattr(bpy.types, name) for name in names if "_PT_" in name]
    return {panel.bl_category for panel in panels if hasattr(panel, "bl_category")}


def wheel_folders() -> list[str]:
    """Return the names of what Blender has unpacked from the wheels of extensions."""
    return sorted(path.name for path in Path(bpy.utils.user_resource("EXTENSIONS")).glob(".local/lib/python*/site-packages/*"))


def main() -> None:
    """Unpack the wheels; unless that is all that is requested, enable and disable the extension twice, and build and bake a cloud."""
    import addon_utils  # only available after bpy has been imported

    addon_utils.extensions_refresh(addon_modules_pending=[MODULE])
    if sys.argv[1:] == ["unpack"]:
        return
    results = {"enabled": [], "disabled": [], "tabs": []}
    for index in range(2):
        addon_utils.enable(MODULE, default_set=True, handle_error=raise_error)
        results["enabled"].append(registered_classes())
        results["tabs"].append(sorted(sidebar_tabs(registered_classes())))
        if index == 1:
            bpy.ops.mesh.primitive_cube_add()
            bpy.ops.farfield.billboards_build(error=10.0, samples=1, levels=1)
            results["wheel_folders"] = [wheel_folders()]
            results["clouds"] = sum(item.get("farfield_kind") == "cloud" for item in bpy.data.objects)
            bpy.ops.farfield.btf_bake(
                views_per_side=2, lights_per_side=2, samples=1, components=1, alpha_components=1, shadows_per_side=4, executor="processes:1"
            )
            results["wheel_folders"].append(wheel_folders())
            results["baked"] = [item.data.materials[0].name for item in bpy.data.objects if item.get("farfield_kind") == "cloud"]
        addon_utils.disable(MODULE, default_set=True, handle_error=raise_error)
        results["disabled"].append(registered_classes())
    bundled = ("scipy", "xatlas", "fast_simplification", "threadpoolctl", "tifffile", "PIL", "meshopt")
    results["wheels"] = {name: sys.modules[name].__file__ for name in bundled if name in sys.modules}
    print("RESULTS " + json.dumps(results))


main()
