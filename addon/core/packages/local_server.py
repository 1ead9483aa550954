"""A web server for one package, for browsers on this machine only."""

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from .served_files import LOOPBACK, OWN_NAMES, PRIVATE_HEADERS, close_package, open_package, read_range

PART_BYTES = 2**18
IDLE_SECONDS = 30.0  # For a request, after which its connection is closed.


class LocalServer(ThreadingHTTPServer):
    """Sends the files of a package in threads of its own, also in ranges, and nothing else, until `close`.

    url: of the page.
    """

    daemon_threads = True

    def __init__(self, folder: Path) -> None:
        """Start serving the package in `folder`.

        Raises:
            FileError: the package is damaged.
        """
        self.files, self.lock = open_package(folder), threading.Lock()
        super().__init__((LOOPBACK, 0), _Handler)
        self.url = f"http://{LOOPBACK}:{self.server_port}/"
        threading.Thread(target=self.serve_forever, name="package view", daemon=True).start()

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing of browsers that end a connection."""

    def close(self) -> None:
        """End the server and close the files."""
        self.shutdown()
        self.server_close()
        with self.lock:
            close_package(self.files)


class _Handler(BaseHTTPRequestHandler):
    """Answers a request with one of the files."""

    server: LocalServer
    protocol_version, timeout = "HTTP/1.1", IDLE_SECONDS

    def do_GET(self) -> None:
        """Send a file or a range of it. Requests to another name are refused: a page of a name that now leads to this machine may read what
        it asks."""
        file = self.server.files.get(self.path.partition("?")[0])
        if self.headers.get("Host", "").rpartition(":")[0] not in OWN_NAMES:
            self.send_error(421)
            return
        if file is None:
            self.send_error(404)
            return
        header = self.headers.get("Range")
        first, end = (0, file.size) if header is None else read_range(header, file.size) or (0, file.size)
        is_part = (first, end) != (0, file.size)
        self.send_response_only(416 if is_part and first == end else 206 if is_part else 200)
        for name, value in PRIVATE_HEADERS.items():
            self.send_header(name, value)
        if is_part:
            self.send_header("Content-Range", f"bytes {f'{first}-{end - 1}' if first < end else '*'}/{file.size}")
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Type", file.content_type)
        self.send_header("Content-Length", str(end - first))
        self.end_headers()
        for offset in range(first, end, PART_BYTES):
            with self.server.lock:
                part = file.read(offset, min(PART_BYTES, end - offset))
            self.wfile.write(part)

    def log_message(self, format: str, *values: object) -> None:
        """Print nothing."""
