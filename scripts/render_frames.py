"""Render frames of a `.blend` file with nothing but Blender: `python3 scripts/render_frames.py FILE FOLDER FRAME...`.

Leaves FRAME.png for every frame in FOLDER, each under another name until it is whole. `blender --background --factory-startup --python
scripts/render_frames.py -- FILE FOLDER FRAME...` does the same. Python in files stays off.
"""

import os
import sys
from pathlib import Path

import bpy


def main(arguments: list[str]) -> None:
    """Render what the arguments say."""
    path, folder, frames = arguments[0], Path(arguments[1]), arguments[2:]
    bpy.ops.wm.open_mainfile(filepath=path, load_ui=False, use_scripts=False)
    scene = bpy.context.scene
    for frame in frames:
        scene.frame_set(int(frame))
        scene.render.filepath = str(folder / f"unfinished-{frame}.png")
        bpy.ops.render.render(write_still=True)
        Path(scene.render.filepath).replace(folder / f"{frame}.png")


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
    sys.stdout.flush()
    os._exit(0)  # Blender 4.5 as a Python module may hang while it is being taken down
