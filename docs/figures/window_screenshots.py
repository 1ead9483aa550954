"""Drive a Blender window through Farfield's panels and take a screenshot of each, in both themes.

    blender --python docs/figures/window_screenshots.py -- FOLDER open|closed TOOL

FOLDER receives the screenshots and index.json with the rectangle of each that shows the sidebar, the editor or the window. For the tools
restore and photos it contains the files that docs/screenshots.py writes. The second argument is the state of the sub-panels. A window shows
the panel of one tool only, since Blender remembers which panels are open. See docs/screenshots.py.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Quaternion

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

from lib.window_session import open_panel, run_steps, wait_for_job

FOLDER, SUBPANELS, TOOL = sys.argv[sys.argv.index("--") + 1 :]
SETTLE_SECONDS = 1.5  # until Blender has drawn a change
THEMES = {"dark": "Blender_Dark.xml", "light": "Blender_Light.xml"}
PHOTOGRAPHS = 8
ALWAYS_OPEN = ("_levels", "_lighting", "_bdam_build", "_bdam_figures")  # sub-panels with the files of a build, and with results

report: dict = {"error": None, "boxes": {}}


def editor() -> bpy.types.Area:
    """Return the area whose sidebar contains the panels: the 3D Viewport, or the Image Editor that replaces it."""
    return next(area for area in bpy.context.window_manager.windows[0].screen.areas if area.type in {"VIEW_3D", "IMAGE_EDITOR"})


def region(region_type: str) -> bpy.types.Region:
    """Return the region of the editor with this type, for instance `UI` for the sidebar."""
    return next(region for region in editor().regions if region.type == region_type)


def is_open(panel: type) -> bool:
    """Whether a sub-panel is open in this window."""
    return SUBPANELS == "open" or panel.__name__.endswith(ALWAYS_OPEN)


def set_theme(name: str) -> None:
    """Switch to one of THEMES."""
    folder = next(path for path in bpy.utils.preset_paths("interface_theme") if Path(path, THEMES[name]).exists())
    bpy.ops.script.execute_preset(filepath=str(Path(folder, THEMES[name])), menu_idname="USERPREF_MT_interface_theme_presets")


def shoot(name: str, part: str = "sidebar") -> Iterator[float]:
    """Take the screenshot `name` in both themes, of the "sidebar", the "editor" or the "window"."""
    for theme in THEMES:
        set_theme(theme)
        sidebar = region("UI")
        sidebar.active_panel_category = "Farfield"
        editor().tag_redraw()
        yield SETTLE_SECONDS
        subprocess.run(["import", "-window", "root", str(Path(FOLDER) / f"{name}-{theme}.png")], check=True)
        window, area = bpy.context.window_manager.windows[0], editor()
        report["boxes"][f"{name}-{theme}"] = {
            "sidebar": (sidebar.x, sidebar.y, sidebar.width, sidebar.height),
            "editor": (area.x, area.y, area.width, area.height),
            "window": (0, 0, window.width, window.height),
        }[part]


def run_job() -> Iterator[float]:
    """Wait until the running job has ended."""
    yield 0.5
    yield from wait_for_job()
    yield SETTLE_SECONDS


def make_statue() -> bpy.types.Object:
    """Add a monkey head with a material to the scene, selected and active."""
    bpy.ops.mesh.primitive_monkey_add(size=2.0)
    statue = bpy.context.active_object
    statue.name = "Statue"
    statue.modifiers.new("Subdivision", "SUBSURF").levels = 2
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new("Clay")
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.55, 0.2, 0.1, 1.0)
    statue.data.materials.append(material)
    return statue


def press(operator: str, mode: str = "INVOKE_DEFAULT", **properties) -> None:
    """Press the button of an operator, or run it without its file browser with the mode "EXEC_DEFAULT"."""
    group, name = operator.split(".")
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=editor(), region=region("WINDOW")):
        getattr(getattr(bpy.ops, group), name)(mode, **properties)


def start(operator: str, **properties) -> Iterator[float]:
    """Press the button of an operator and wait for its job."""
    press(operator, **properties)
    yield from run_job()


def visit() -> Iterator[float]:
    """Visit all panels, as pauses in seconds."""
    scene = bpy.context.scene
    if TOOL == "restore":
        editor().ui_type = "IMAGE_EDITOR"
    else:
        editor().spaces.active.region_3d.view_distance = 7.0
        bpy.data.objects.remove(bpy.data.objects["Cube"])
        make_statue()
    if TOOL == "btf":
        scene.farfield_billboards.levels, scene.farfield_billboards.samples = 1, 1
        yield from start("farfield.billboards_build")
    open_panel(TOOL, is_open)
    editor().spaces.active.show_region_ui = True
    yield 3.0
    yield from VISITS[TOOL](scene)


def visit_billboards(scene: bpy.types.Scene) -> Iterator[float]:
    """Before and after *Build*."""
    scene.farfield_billboards.samples = 2
    yield 4.0  # the estimate is computed in the background
    yield from shoot("billboards-settings")
    yield from start("farfield.billboards_build")
    yield from shoot("billboards-levels")
    editor().spaces.active.shading.type = "MATERIAL"
    yield 3 * SETTLE_SECONDS  # shaders compile
    yield from shoot("window", "window")
    editor().spaces.active.shading.type = "SOLID"


def visit_btf(scene: bpy.types.Scene) -> Iterator[float]:
    """Before and after a bake."""
    yield from shoot("btf-settings")
    group = scene.farfield_btf
    group.views_per_side, group.samples = 2, 1
    yield from start("farfield.btf_bake")
    yield from shoot("btf-baked")


def visit_unwrap(_scene: bpy.types.Scene) -> Iterator[float]:
    """Before and after *Unwrap*."""
    yield from shoot("unwrap-settings")
    yield from start("farfield.unwrap")
    yield from shoot("unwrap-figures")


def visit_photos(scene: bpy.types.Scene) -> Iterator[float]:
    """Before and after photographs have cameras."""
    bpy.data.objects.remove(bpy.data.objects["Camera"])
    yield from shoot("photos-mesh")
    image = bpy.data.images.load(str(Path(FOLDER, "weave.png")))
    for index in range(PHOTOGRAPHS):
        camera = bpy.data.objects.new(f"Photograph {index}", bpy.data.cameras.new(f"Photograph {index}"))
        turn = Quaternion((0.0, 0.0, 1.0), 2.0 * np.pi * index / PHOTOGRAPHS)
        camera.matrix_world = turn.to_matrix().to_4x4() @ Matrix.Translation((0.0, -6.0, 0.0)) @ Matrix.Rotation(0.5 * np.pi, 4, "X")
        camera.data.show_background_images = True
        camera.data.background_images.new().image = image
        scene.collection.objects.link(camera)
    yield from shoot("photos-photographs")


def visit_clipbox(scene: bpy.types.Scene) -> Iterator[float]:
    """Before and after *Create*."""
    yield from shoot("clipbox-settings")
    scene.farfield_clipbox.resolution = 32
    yield from start("farfield.clipbox_create")
    yield from shoot("clipbox-active")


def visit_bdam(scene: bpy.types.Scene) -> Iterator[float]:
    """Before *Build*, and after *Load*."""
    y, x = np.mgrid[0:257, 0:257] / 40.0
    np.save(Path(FOLDER, "valley.npy"), (200.0 * np.sin(x + np.sin(y)) * np.cos(0.7 * y)).astype(np.float32))
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(FOLDER, "valley.blend")))  # so that paths are relative and short
    group = scene.farfield_bdam_build
    group.sources.add().name = "//valley.npy"
    group.store, group.cell_size = "//terrain", 10.0
    yield from shoot("bdam-settings")
    yield from start("farfield.bdam_build")
    press("farfield.bdam_load", "EXEC_DEFAULT", directory=str(Path(FOLDER, "terrain")))
    yield SETTLE_SECONDS
    yield from shoot("bdam-loaded")


def visit_texmesh(scene: bpy.types.Scene) -> Iterator[float]:
    """Before and after *Make Levels*, with a grid of colors as the texture."""
    statue = bpy.data.objects["Statue"]
    statue.modifiers["Subdivision"].levels = 1
    tree = statue.data.materials[0].node_tree
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images.new("Colors", 256, 256)
    node.image.generated_type = "COLOR_GRID"
    tree.links.new(node.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    yield from shoot("texmesh-settings")
    group = scene.farfield_texmesh
    group.views, group.max_image = 2, 256
    yield from start("farfield.texmesh_levels")
    yield from shoot("texmesh-levels")


def visit_packages(scene: bpy.types.Scene) -> Iterator[float]:
    """With a folder for the package."""
    scene.farfield_packages.folder = "//statue"
    yield from shoot("packages-settings")


def visit_restore(scene: bpy.types.Scene) -> Iterator[float]:
    """Before and after *Restore*, with a mask as if it had been painted."""
    space = editor().spaces.active
    space.image = bpy.data.images.load(str(Path(FOLDER, "weave.png")))
    yield SETTLE_SECONDS
    press("farfield.restore_mask")
    painted = bpy.data.images.load(str(Path(FOLDER, "mask.png")))
    bpy.data.images[scene.farfield_restore.mask_image].pixels = painted.pixels[:]
    show_fitted(bpy.data.images["weave.png"])
    yield 2 * SETTLE_SECONDS  # the outline is found in the background
    yield from shoot("restore-mask", "editor")
    yield from start("farfield.restore_image")
    show_fitted(space.image)
    yield SETTLE_SECONDS
    yield from shoot("restore-result", "editor")


def show_fitted(image: bpy.types.Image) -> None:
    """Show `image` in the Image Editor, as large as it fits."""
    space = editor().spaces.active
    space.ui_mode, space.image = "VIEW", image
    press("image.view_all", fit_view=True)


VISITS = {
    "billboards": visit_billboards,
    "btf": visit_btf,
    "unwrap": visit_unwrap,
    "photos": visit_photos,
    "restore": visit_restore,
    "clipbox": visit_clipbox,
    "bdam": visit_bdam,
    "texmesh": visit_texmesh,
    "packages": visit_packages,
}


def write_index(error: str | None) -> None:
    """Write index.json."""
    report["error"] = error
    Path(FOLDER, "index.json").write_text(json.dumps(report), encoding="utf-8")


bpy.context.preferences.system.use_region_overlap = False
run_steps(visit(), write_index)
