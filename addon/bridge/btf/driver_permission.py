"""Whether drivers of the open file may run Python: by the preference *Auto Run Python Scripts* and the choice on opening the file."""

from collections.abc import Iterator

import bpy

PROBE = "farfield_driver_probe"


def may_run_python_drivers() -> bool:
    """Return whether drivers of the open file run any Python. False without asking Blender if none of them needs that permission.

    Blender does not tell. It evaluates a driver of a temporary scene, which calls a method: restricted drivers may not.
    """
    if not any(_needs_permission(driver) for driver in _drivers()):
        return False
    calls: list[int] = []
    scene = bpy.data.scenes.new("Farfield Driver Probe")
    try:
        bpy.app.driver_namespace[PROBE] = calls
        scene[PROBE] = 0.0
        driver = scene.driver_add(f'["{PROBE}"]').driver
        driver.type, driver.expression = "SCRIPTED", f"{PROBE}.append(1) or 0.0"
        scene.view_layers[0].update()
    finally:
        bpy.app.driver_namespace.pop(PROBE, None)
        bpy.data.scenes.remove(scene)
    return bool(calls)


def _needs_permission(driver: bpy.types.Driver) -> bool:
    """Whether a driver runs the full Python interpreter. Some of these do not need the permission; Blender decides when it runs them."""
    return driver.type == "SCRIPTED" and not driver.is_simple_expression


def _drivers() -> Iterator[bpy.types.Driver]:
    """Yield all drivers of the open file, those of linked data and of node trees in other data included."""
    for member in bpy.data.bl_rna.properties:
        if member.type != "COLLECTION":
            continue
        for data in getattr(bpy.data, member.identifier):
            for owner in (data, getattr(data, "node_tree", None)):
                animation = getattr(owner, "animation_data", None)
                if animation is not None:
                    yield from (curve.driver for curve in animation.drivers)
