"""A real Blender window with this checkout installed, for tests and for screenshots in the docs.

The window is opened on a virtual screen by the launcher `../shared/tools/blender-gui`, which exists on development machines only.
"""

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from lib import environment

LAUNCHER = environment.ROOT.parent / "shared" / "tools" / "blender-gui"
PACKAGE = "bl_ext.user_default.farfield"  # the installed extension
CACHE_VARIABLE = "XDG_CACHE_HOME"  # the launcher keeps Blender there
_CACHE = os.environ.setdefault("FARFIELD_LAUNCHER_CACHE", os.environ.get(CACHE_VARIABLE, ""))  # tests and their processes change it later


def unavailable_reason() -> str:
    """Return why no window can be opened on this machine, or an empty string."""
    if not LAUNCHER.exists():
        return "there is no ../shared/tools/blender-gui to open a window with"
    folder = Path(subprocess.run([LAUNCHER, "path"], env=launcher_variables(), capture_output=True, text=True, check=True).stdout.strip())
    return "" if folder.exists() else "run `../shared/tools/blender-gui setup` once"


def install(resources: Path) -> None:
    """Install this checkout as an extension into the user folder `resources` of a Blender."""
    folder = resources / "extensions" / "user_default" / "farfield"
    folder.mkdir(parents=True)
    for name in ("__init__.py", "blender_manifest.toml"):
        shutil.copy(environment.ROOT / name, folder)
    shutil.copytree(environment.ROOT / "addon", folder / "addon", ignore=shutil.ignore_patterns("__pycache__"))


def run(
    resources: Path, script: Path, arguments: Sequence[str | Path], *, size: tuple[int, int], seconds: int
) -> subprocess.CompletedProcess:
    """Open a window of `size` pixels with factory settings, run `script` in it, and wait until Blender quits.

    Args:
        resources: the user folder, see `install`.
        arguments: what the script finds after `--`.
        seconds: Blender is ended after this time.
    """
    command = [LAUNCHER, "run", "-s", f"{size[0]}x{size[1]}", "-t", str(seconds), "--", "--factory-startup", "--enable-event-simulate"]
    return subprocess.run(
        [*command, "--python", script, "--", *arguments],
        cwd=environment.ROOT,
        env=launcher_variables() | {"BLENDER_USER_RESOURCES": str(resources)},
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )


def launcher_variables() -> dict[str, str]:
    """Return the environment of the launcher: that of this process, with the cache folder that it started with."""
    variables = {name: value for name, value in os.environ.items() if name != CACHE_VARIABLE}
    return variables | {CACHE_VARIABLE: _CACHE} if _CACHE else variables
