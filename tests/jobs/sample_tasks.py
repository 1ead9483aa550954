"""Tasks that worker processes run in tests, as a module of the extension: `tests.jobs.sample_tasks`."""

import os
import signal
import sys
import time
from pathlib import Path

from ...addon.core.errors import FarfieldError, FileError


def open_tasks(arguments):
    """Return the task with the name in the first argument. The second one is a folder in which it may write."""
    name, folder = arguments[0], Path(arguments[1])

    def note(word):
        with (folder / word).open("a", encoding="utf-8") as stream:
            stream.write(f"{os.getpid()}\n")

    def describe(item):
        print("this is not a reply")
        return {"double": 2 * item["number"], "text": item["text"], "tuple": (1, None, 0.1), item["number"]: []}

    def write(item):
        note("processes")
        (folder / f"{item}.txt").write_text(str(item * item), encoding="utf-8")

    def process_state(item):
        import numpy as np
        import scipy.sparse  # noqa: F401 - the import must succeed

        np.ones((300, 300)) @ np.ones((300, 300))
        status = Path("/proc/self/status")
        threads = status.read_text(encoding="utf-8").split("Threads:")[1].split()[0] if status.exists() else None
        return {"blender": "bpy" in sys.modules, "root": hasattr(sys.modules[__name__.partition(".")[0]], "register"), "threads": threads}

    def fail(item):
        if item == 3:
            raise FileError("Kein Platz für „Kachel 3“.")
        return item

    def crash_once(item):
        note("calls")
        if item in (5, 6) and not (folder / f"crashed-{item}").exists():
            (folder / f"crashed-{item}").touch()
            kill_self()
        return -item

    def crash(item):
        note("calls")
        if item == 5:
            kill_self()
        return item

    def raise_exception(item):
        raise ZeroDivisionError("Null ist null.")

    def exhaust(item):
        raise MemoryError

    def hang(item):
        note("hangs")
        time.sleep(600.0)

    if name == "refuse":
        raise FarfieldError("The tasks cannot be opened.")
    tasks = (describe, write, process_state, fail, crash_once, crash, raise_exception, exhaust, hang)
    return {task.__name__: task for task in tasks}[name]


def main(arguments):
    """A module that `core_command` can call: exit with a code, or fail in the way that is named."""
    if arguments[0] == "error":
        raise FileError("Kein Platz für „alle“.")
    print(*arguments[1:])
    return int(arguments[0])


def kill_self():
    """End this process as a crash would."""
    os.kill(os.getpid(), signal.SIGKILL) if hasattr(signal, "SIGKILL") else os._exit(77)
