"""Worker process of a task pool: calls one function for many items. See `task_pool`.

Local workers read requests from stdin until it ends: lines with a JSON list of items. To each item they reply on stdout, in order, with a
line {"reply": ...}, or {"error": ...} if the function has raised a FarfieldError. Workers on other machines read one request from a
file and write the replies to another one.
"""

import argparse
import json
import os
import signal
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import FarfieldError
from . import heartbeat
from .core_worker import import_extension_module

REPLY_KEY, ERROR_KEY = "reply", "error"

Task = Callable[[Any], Any]


def task_arguments(module: str, arguments: list[str], heartbeat_file: Path) -> list[str]:
    """Return the arguments of a worker that runs the tasks of `module` for requests from stdin."""
    return ["--module", module, "--arguments", json.dumps(arguments), "--heartbeat", str(heartbeat_file)]


def file_arguments(request_file: Path, reply_file: Path) -> list[str]:
    """Return further arguments of a worker that runs the tasks of one request in a file."""
    return ["--request-file", str(request_file), "--reply-file", str(reply_file)]


def main(arguments: list[str]) -> int:
    """Run the tasks of all requests; return the exit code. Raises FarfieldError if the module cannot open its tasks."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--module", required=True)
    parser.add_argument("--arguments", type=json.loads, required=True)
    parser.add_argument("--heartbeat", type=Path, required=True)
    parser.add_argument("--request-file", type=Path)
    parser.add_argument("--reply-file", type=Path)
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl+C reaches the processes of a terminal; this one ends with its run
    heartbeat.exit_when_run_ends(options.heartbeat)
    stdout = _claim_stdout()
    task = import_extension_module(options.module).open_tasks(options.arguments)
    if options.request_file is None:
        _run_requests(task, sys.stdin.buffer, stdout)
    else:
        with options.reply_file.open("wb") as replies:
            _run_requests(task, [options.request_file.read_bytes()], replies)
    return 0


def read_reply(line: bytes) -> Any:
    """Return the reply in a line of a worker.

    Raises:
        FarfieldError: the task has raised it.
    """
    message = json.loads(line)
    if ERROR_KEY in message:
        raise FarfieldError(message[ERROR_KEY])
    return message[REPLY_KEY]


def _run_requests(task: Task, requests: Iterable[bytes], replies: BinaryIO) -> None:
    """Reply to each item of each of the lines `requests`."""
    for request in requests:
        for item in json.loads(request):
            try:
                message = {REPLY_KEY: task(item)}
            except FarfieldError as error:
                message = {ERROR_KEY: str(error)}
            replies.write(json.dumps(message).encode() + b"\n")
            replies.flush()


def _claim_stdout() -> BinaryIO:
    """Return a stream to stdout. What libraries print goes to stderr from now on."""
    descriptor = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return os.fdopen(descriptor, "wb")
