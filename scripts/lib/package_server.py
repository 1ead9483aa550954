"""A web server for one package, by default on this machine only.

It sends the files that `served_files.open_package` has opened at its start, also in ranges, and nothing else. Pages of other servers may
read them (CORS), so that a server can be a mirror, unless it is private: then it answers only to a name of this machine, so that no page
that is open in the same browser can read the package. A client that sends or takes data too slowly is disconnected.
"""

import asyncio
import threading
import time
import webbrowser
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream, StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, RequestHandler

from lib import environment

environment.import_farfield()

from farfield.addon.core.errors import FileError
from farfield.addon.core.files.file_access import error_reason
from farfield.addon.core.packages.files import find_version
from farfield.addon.core.packages.served_files import (
    HEADERS,
    LOOPBACK,
    OWN_NAMES,
    PRIVATE_HEADERS,
    PackageFile,
    close_package,
    open_package,
    read_range,
)
from lib.connection_rate import ConnectionRate, Throttle

MAX_HEADER_BYTES = 16384
READ_BUFFER_BYTES = 65536  # per connection
WAIT_SECONDS = 0.2
IMMUTABLE = "max-age=31536000, immutable"  # The header of URLs that name their content.
SHARED_HEADERS = HEADERS | {
    "Access-Control-Allow-Origin": "*",
    "Access-Control-Allow-Methods": "GET, HEAD",
    "Access-Control-Allow-Headers": "Range, If-Range",
    "Access-Control-Expose-Headers": "Accept-Ranges, Content-Range, Content-Length, ETag",
    "Access-Control-Max-Age": "86400",
    "Cross-Origin-Resource-Policy": "cross-origin",
    "Timing-Allow-Origin": "*",
}


@dataclass(frozen=True)
class ClientLimits:
    """connections: at once; more are closed. idle_seconds: for a request, from its first byte or from the last response on. send_seconds:
    for one part of a response to be taken."""

    connections: int = 256
    idle_seconds: float = 30.0
    send_seconds: float = 30.0


class PackageHandler(RequestHandler):
    """Answers a request with one of the files of the package."""

    SUPPORTED_METHODS = ("GET", "HEAD", "OPTIONS")

    def initialize(self, files: Mapping[str, PackageFile], throttle: Throttle, limits: ClientLimits, is_private: bool) -> None:
        """Keep what requests share: files by the path of their URL."""
        self._files, self._throttle, self._limits, self._is_private = files, throttle, limits, is_private
        self._set_common_headers()

    def prepare(self) -> None:
        """Refuse requests to a private server by another name: a page of a name that now leads to this machine may read what it asks."""
        if self._is_private and self.request.host_name not in OWN_NAMES:
            self.send_error(421)

    def _set_common_headers(self) -> None:
        """Set what every response has."""
        self.clear_header("Server")
        for name, value in (PRIVATE_HEADERS if self._is_private else SHARED_HEADERS).items():
            self.set_header(name, value)

    async def get(self) -> None:
        """Send a file or a range of it."""
        await self._throttle.begin()
        file = self._files.get(unquote(self.request.path))
        if file is None:
            self.send_error(404)
            return
        is_compressed = file.compressed is not None and "gzip" in self.request.headers.get("Accept-Encoding", "")
        tag = f'"{file.digest[:32]}{"-gzip" if is_compressed else ""}"'
        self.set_header("ETag", tag)
        self.set_header("Cache-Control", IMMUTABLE if self.request.query == find_version(file.digest) else "no-cache")
        self.set_header("Content-Type", file.content_type)
        if file.compressed is not None:
            self.set_header("Vary", "Accept-Encoding")
        else:
            self.set_header("Accept-Ranges", "bytes")
        if tag in [item.strip() for item in self.request.headers.get("If-None-Match", "").split(",")]:
            self.set_status(304)
            self.clear_header("Content-Type")
        elif is_compressed and file.compressed is not None:
            self.set_header("Content-Encoding", "gzip")
            content = file.compressed
            await self._send(lambda offset, size: content[offset : offset + size], 0, len(content))
        else:
            first, end = self._find_range(file, tag)
            if first == end and file.size:
                self.set_status(416)
                self.set_header("Content-Range", f"bytes */{file.size}")
                return
            if (first, end) != (0, file.size):
                self.set_status(206)
                self.set_header("Content-Range", f"bytes {first}-{end - 1}/{file.size}")
            await self._send(file.read, first, end)

    async def head(self) -> None:
        """Send the headers of `get`."""
        await self.get()

    def options(self) -> None:
        """Allow pages of other servers to ask for ranges."""
        self.set_status(204)

    def write_error(self, status_code: int, **_details: object) -> None:
        """Send the reason as text."""
        self._set_common_headers()
        if status_code == 405:
            self.set_header("Allow", ", ".join(self.SUPPORTED_METHODS))
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code} {self._reason}\n")

    def _find_range(self, file: PackageFile, tag: str) -> tuple[int, int]:
        header = self.request.headers.get("Range")
        is_current = self.request.headers.get("If-Range", tag) == tag
        if header is None or not is_current or file.compressed is not None:
            return 0, file.size
        return read_range(header, file.size) or (0, file.size)

    async def _send(self, read: Callable[[int, int], bytes], first: int, end: int) -> None:
        self.set_header("Content-Length", str(end - first))
        if self.request.method == "HEAD":
            return
        offset = first
        try:
            while offset < end:
                part = read(offset, min(self._throttle.part_size(), end - offset))
                if not part:  # the file has been truncated: the client sees a response that is too short
                    self.request.connection.close()
                    return
                await self._throttle.carry(len(part))
                self.write(part)
                await asyncio.wait_for(self.flush(), self._limits.send_seconds)
                offset += len(part)
        except (TimeoutError, StreamClosedError):
            self.request.connection.close()


class PackageHttpServer(HTTPServer):
    """An HTTP server with a limited number of connections."""

    def initialize(self, application: Application, limits: ClientLimits) -> None:
        """Apply the limits."""
        self._limits, self._connection_count = limits, 0
        super().initialize(
            application,
            max_header_size=MAX_HEADER_BYTES,
            max_body_size=1,  # requests have no body; 0 would be the default
            max_buffer_size=READ_BUFFER_BYTES,
            chunk_size=READ_BUFFER_BYTES // 2,
            idle_connection_timeout=limits.idle_seconds,
            body_timeout=limits.idle_seconds,
        )

    def handle_stream(self, stream: IOStream, address: tuple) -> None:
        """Accept or close a new connection."""
        if self._connection_count >= self._limits.connections:
            stream.close()
            return
        self._connection_count += 1
        super().handle_stream(stream, address)

    def on_close(self, server_conn: object) -> None:
        """Count a connection that ended."""
        self._connection_count -= 1
        super().on_close(server_conn)


@contextmanager
def run_server(
    folder: Path,
    address: str = LOOPBACK,
    port: int = 0,
    connection: ConnectionRate | None = None,
    limits: ClientLimits | None = None,
    is_private: bool = False,
) -> Iterator[str]:
    """Serve the package in `folder` within the context, from a thread of its own. Yields the URL of its page.

    Args:
        address: of the network interface; "127.0.0.1" for this machine only. port: 0 for any free one. connection: rate of all responses
            together, None for no limit. is_private: whether pages of other servers may not read the package.

    Raises:
        FileError: the package is damaged, or the address or port cannot be used.
    """
    files = open_package(folder)
    try:
        sockets = bind_sockets(port, address)
    except (OSError, OverflowError, UnicodeError) as error:
        close_package(files)
        reason = error_reason(error) if isinstance(error, OSError) else str(error)
        raise FileError(f"The server cannot use port {port} of {address} ({reason}); choose another port or address.") from error
    loop = asyncio.new_event_loop()
    stopping = asyncio.Event()

    async def run() -> None:
        shared = {"files": files, "throttle": Throttle(connection), "limits": limits or ClientLimits(), "is_private": is_private}
        application = Application(default_handler_class=PackageHandler, default_handler_args=shared, log_function=lambda _handler: None)
        server = PackageHttpServer(application, shared["limits"])
        server.add_sockets(sockets)
        await stopping.wait()
        server.stop()
        await server.close_all_connections()

    thread = threading.Thread(target=loop.run_until_complete, args=(run(),), name="package server", daemon=True)
    thread.start()
    try:
        host = f"[{address}]" if ":" in address else address
        yield f"http://{host}:{sockets[0].getsockname()[1]}/"
    finally:
        loop.call_soon_threadsafe(stopping.set)
        thread.join()
        loop.close()
        close_package(files)


def serve(
    folder: Path,
    address: str,
    port: int,
    connection: ConnectionRate | None,
    announce: Callable[[str], None],
    wait: Callable[[], None],
    is_private: bool = False,
) -> None:
    """Serve the package in `folder` until `wait`, which is called several times a second, raises KeyboardInterrupt. announce: called with
    the URL of the page. Otherwise see `run_server`."""
    with run_server(folder, address, port, connection, is_private=is_private) as url, suppress(KeyboardInterrupt):
        announce(url)
        while True:
            wait()
            time.sleep(WAIT_SECONDS)


def open_view(
    folder: Path, port: int, connection: ConnectionRate | None, announce: Callable[[str], None], wait: Callable[[], None]
) -> None:
    """Show the package in `folder` in the user's web browser and serve it to this page only, as `serve` does."""

    def show(url: str) -> None:
        announce(url)
        webbrowser.open(url)

    serve(folder, LOOPBACK, port, connection, show, wait, is_private=True)
