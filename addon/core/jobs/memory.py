"""Memory that a process gives back to the system."""

import ctypes
import sys


def release_memory() -> None:
    """Give memory that is not used any more back to the system.

    The allocator of Linux keeps it, in the order of its arrays: a third of the memory of a long job, after parts of it that ran in several
    threads. Other systems, and Linux with another allocator, need no help.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # The one of glibc.
        if trim is not None:
            trim(0)
