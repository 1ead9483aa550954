"""The web server of packages under random requests of many clients at once, on this machine only."""

import asyncio
import sys
import tempfile
import threading
import time
from argparse import Namespace
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from small_packages import write_opaque_package

from farfield.addon.core.packages.files import read_page
from lib.package_server import run_server

CLIENTS, REQUESTS = 100, 100_000
CANARY = b"canary-5d41402abc4b2a76"
NAMES = ("manifest.json", "mesh.bin", "textures.bin", "levels.glb", "index.html", "main.js", "secret.txt", "private.txt", "link.glb", "")
PIECES = (
    *(
        "..",
        ".",
        "/",
        "//",
        "\\",
        "%2e",
        "%2E%2e",
        "%2f",
        "%5c",
        "%00",
        "%c0%ae",
        "%252e",
        "\u2025",
        "\uff0e",
        "~",
        "etc/passwd",
        "C:",
        ";",
        "?",
        "#",
    ),
    *("package", "sub", "inner.glb", "con", "nul", "%", "%zz", " ", "http://127.0.0.1/", "file://", "..;/", "....//", *NAMES),
)
METHODS = (*["GET"] * 12, "HEAD", "OPTIONS", "POST", "PUT", "get", "TRACE", "\x00")
RANGES = (
    "bytes={0}-{1}",
    "bytes={0}-",
    "bytes=-{0}",
    "bytes={1}-{0}",
    "bytes={0}-{1},{1}-{0}",
    "bytes=a-b",
    "lines=1-2",
    "bytes={0}{1}{0}{1}{0}-",
)


def measure_server(given: Namespace) -> dict[str, Any]:
    """Send random requests to a server of a package that has secrets next to it, and return what it answered: how often each status, files
    that it opened, answers with a secret, and answers that are no part of the package."""
    seed, opened = given.seed, []
    is_recording = True

    def record(event: str, arguments: tuple) -> None:
        if is_recording and event == "open" and threading.current_thread().name == "package server":
            opened.append(str(arguments[0]))

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "package"
        write_opaque_package(folder, seed)
        (folder / "levels.glb").write_bytes(b"glTF" * 1000)
        (folder / "sub").mkdir()
        for path in (folder.parent / "secret.txt", folder / "private.txt", folder / "sub" / "inner.glb"):
            path.write_bytes(CANARY)
        with suppress(OSError):  # no rights to make links on Windows
            (folder / "link.glb").symlink_to(folder.parent / "secret.txt")
        contents = [path.read_bytes() for path in (*folder.glob("m*"), *folder.glob("t*"))] + list(read_page().values())
        with run_server(folder) as url:
            asyncio.run(_send_all(url, seed, CLIENTS, contents))  # the server imports what it needs
            sys.addaudithook(record)
            start = time.perf_counter()
            outcome = asyncio.run(_send_all(url, seed, REQUESTS, contents))
            seconds = time.perf_counter() - start
            is_recording = False
    return {"requests": REQUESTS, "clients": CLIENTS, "seconds": round(seconds, 1), "opened": opened, **outcome}


async def _send_all(url: str, seed: int, requests: int, contents: list[bytes]) -> dict[str, Any]:
    counts: Counter[str] = Counter()
    generators = np.random.default_rng(seed).spawn(CLIENTS)
    await asyncio.gather(*(_run_client(url, generator, requests // CLIENTS, contents, counts) for generator in generators))
    names = ("secrets", "foreign")
    return {name: counts.pop(name, 0) for name in names} | {"answers": dict(sorted(counts.items()))}


async def _run_client(url: str, random: np.random.Generator, requests: int, contents: list[bytes], counts: Counter[str]) -> None:
    """Send requests one after the other, on a new connection whenever the server has closed the last one."""
    parts = urlsplit(url)
    reader, writer = await asyncio.open_connection(parts.hostname, parts.port)
    for _ in range(requests):
        content, is_head = make_request(random)
        try:
            writer.write(content)
            await writer.drain()
            status, body = await asyncio.wait_for(_read_answer(reader, is_head), 120.0)
        except (ConnectionError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            status, body = "closed", b""
        counts[status] += 1
        counts["secrets"] += CANARY in body
        counts["foreign"] += status in ("200", "206") and not any(body in known for known in contents)
        if status in ("closed", "400") or reader.at_eof():
            writer.close()
            reader, writer = await asyncio.open_connection(parts.hostname, parts.port)
    writer.close()


def make_request(random: np.random.Generator) -> tuple[bytes, bool]:
    """Return a random request, and whether its method is HEAD."""
    method = METHODS[random.integers(len(METHODS))]
    if random.random() < 0.5:
        path = "/" + NAMES[random.integers(len(NAMES))]
    else:
        path = "/" * int(random.random() < 0.9) + "".join(PIECES[index] for index in random.integers(0, len(PIECES), random.integers(1, 7)))
    lines = [f"{method} {path} HTTP/1.1", "Host: 127.0.0.1"]
    if random.random() < 0.5:
        lines.append("Range: " + RANGES[random.integers(len(RANGES))].format(*random.integers(0, 10 ** random.integers(1, 6), 2)))
    if random.random() < 0.05:
        lines.append(bytes(random.integers(0, 256, 20, np.uint8)).decode("latin-1").replace("\r", "").replace("\n", ""))
    return "\r\n".join(lines).encode("utf-8", "surrogatepass") + b"\r\n\r\n", method == "HEAD"


async def _read_answer(reader: asyncio.StreamReader, is_head: bool) -> tuple[str, bytes]:
    head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1")
    status = head.split(" ", 2)[1]
    sizes = [int(line.split(":")[1]) for line in head.split("\r\n") if line.lower().startswith("content-length:")]
    has_body = sizes and not is_head and status not in ("204", "304")
    return status, await reader.readexactly(sizes[0]) if has_body else b""
