"""Render frames of a `.blend` file without Farfield: `python3 scripts/render_frames.py FILE FOLDER FRAME...`.

Writes FRAME.png to FOLDER for every frame; each file appears complete. `blender --background --factory-startup --python
scripts/render_frames.py -- FILE FOLDER FRAME...` does the same. Python scripts in the file are not run.
"""

import os
import sys
from pathlib import Path

import bpy


def main(arguments: list[str]) -> None:
    """Render the frames given by the arguments."""
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
    os._exit(0)  # Blender 4.5 as a Python module may hang at exit
