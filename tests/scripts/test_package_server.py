"""The web server of packages: ranges, caching, mirrors, and refusal of everything that is not a file of the package."""

import gzip
import hashlib
import http.client
import socket
import sys
import threading
import time
from contextlib import closing, suppress
from pathlib import Path
from urllib.parse import quote, urlsplit

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("tornado")

from small_packages import write_opaque_package

from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.packages.files import read_page
from farfield.addon.core.packages.local_server import LocalServer
from farfield.addon.core.packages.served_files import read_range
from lib.connection_rate import ConnectionRate, parse_rate
from lib.package_server import ClientLimits, run_server

SECRET = b"canary in the coal mine"
PATH_TRICKS = [
    *("/../secret.txt", "/%2e%2e/secret.txt", "/..%2fsecret.txt", "/%2e%2e%2fsecret.txt", "/%252e%252e/secret.txt"),
    *("/..\\secret.txt", "/%5c..%5csecret.txt", "\\..\\secret.txt", "//secret.txt", "/./../secret.txt", "/mesh.bin/../../secret.txt"),
    *("/%c0%ae%c0%ae/secret.txt", "/%uff0e%uff0e/secret.txt", "/\u2025/secret.txt", "/secret.txt%00.bin", "/mesh.bin%00", "/%00"),
    *(
        "/private.txt",
        "/private.glb",
        "/.hidden.glb",
        "/mesh.bin~",
        "/.manifest.json",
        "/link.glb",
        "/sub/inner.glb",
        "/sub",
        "/.",
        "/..",
        "/mesh.bin/",
        "/MESH.BIN",
        "/mesh.bin ",
        "/%2Fmesh.bin",
    ),
    *(
        "file:///etc/passwd",
        "http://127.0.0.1/secret.txt",
        "//127.0.0.1/secret.txt",
        "*",
        "mesh.bin",
        "/mesh.bin;x",
        "/con",
        "/C:/secret.txt",
    ),
]


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    """A package with a secret next to it, a file that does not belong to it, and a link to the secret."""
    folder = tmp_path_factory.mktemp("served") / "package"
    write_opaque_package(folder)
    (folder / "levels.glb").write_bytes(b"glTF" * 100)
    (folder / "sub").mkdir()
    others = ("private.txt", "private.glb", ".hidden.glb", "mesh.bin~", ".manifest.json", "sub/inner.glb")
    for path in (folder.parent / "secret.txt", *(folder / name for name in others)):
        path.write_bytes(SECRET)
    with suppress(OSError):  # no rights to make links on Windows
        (folder / "link.glb").symlink_to(folder.parent / "secret.txt")
    return folder


@pytest.fixture(scope="module")
def url(package):
    with run_server(package, limits=ClientLimits(connections=150, idle_seconds=1.0, send_seconds=1.0)) as url:
        yield url


def request(url: str, path: str, headers: dict[str, str] | None = None, method: str = "GET") -> tuple[int, http.client.HTTPMessage, bytes]:
    with closing(http.client.HTTPConnection(urlsplit(url).netloc, timeout=20)) as connection:
        connection.request(method, path, headers=headers or {})
        response = connection.getresponse()
        return response.status, response.headers, response.read()


def exchange(url: str, content: bytes) -> bytes:
    """Return all that the server answers to `content`, until it closes the connection."""
    with socket.create_connection((urlsplit(url).hostname, urlsplit(url).port), timeout=20) as connection:
        connection.sendall(content)
        answer = b""
        with suppress(ConnectionResetError):
            while part := connection.recv(65536):
                answer += part
        return answer


def test_files_of_package_are_sent(url, package):
    for name in ("manifest.json", "mesh.bin", "textures.bin", "levels.glb"):
        status, headers, body = request(url, quote(f"/{name}"))
        assert (status, body) == (200, (package / name).read_bytes())
        assert headers["Access-Control-Allow-Origin"] == "*"
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert "Server" not in headers
    assert request(url, "/")[2] == request(url, "/index.html")[2] == read_page()["index.html"]


def test_urls_that_name_their_content_are_kept_for_ever_and_others_are_asked_for_again(url, package):
    for name in ("mesh.bin", "textures.bin", "main.js", "style.css"):
        content = request(url, f"/{name}")[2]
        version = hashlib.sha256(content).hexdigest()[:16]
        for query, expected in ((f"?{version}", "max-age=31536000, immutable"), ("?other", "no-cache"), ("", "no-cache")):
            for headers in ({}, {"Range": "bytes=1-2"}):
                _, answer, body = request(url, f"/{name}{query}", headers)
                assert answer["Cache-Control"] == expected and body in (content, content[1:3])
    for name in ("", "index.html", "manifest.json"):
        _, answer, _ = request(url, f"/{name}")
        assert answer["Cache-Control"] == "no-cache"
        assert request(url, f"/{name}", {"If-None-Match": answer["ETag"]})[0] == 304


def test_a_private_server_answers_only_to_this_machine_and_its_own_page(package):
    with run_server(package, is_private=True) as url:
        place = urlsplit(url)
        for host, expected in (
            (place.netloc, 200),
            (f"localhost:{place.port}", 200),
            (f"evil.example:{place.port}", 421),
            ("evil.example", 421),
        ):
            for path in ("/manifest.json", "/none"):
                status, headers, body = request(url, path, {"Host": host, "Origin": "http://evil.example"})
                assert status == (404 if (expected, path) == (200, "/none") else expected)
                assert not any(name.startswith("access-control") for name in map(str.lower, headers))
                assert headers["Cross-Origin-Resource-Policy"] == "same-origin" and "Server" not in headers
                assert (body == (package / "manifest.json").read_bytes()) == (status == 200)


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        *(("bytes=0-0", (0, 1)), ("bytes=10-19", (10, 20)), ("bytes=90-", (90, 100)), ("bytes=-7", (93, 100)), ("bytes=-1000", (0, 100))),
        *(("bytes=50-1000", (50, 100)), ("BYTES= 5-6 ", (5, 7)), ("bytes=100-", (100, 100)), ("bytes=-0", (100, 100))),
        *(("bytes=200-300", (100, 100)), ("bytes=5-4", None), ("bytes=", None), ("bytes=-", None), ("bytes=a-b", None), ("", None)),
        *(("bytes=0-1,5-6", None), ("lines=0-5", None), ("bytes=--5", None), ("bytes=1-2-3", None), ("bytes=٣-٤", None)),
        *((f"bytes=0-{'9' * 4000}", None), (f"bytes={'9' * 18}-", (100, 100)), ("bytes=0x1-2", None), ("bytes=+1-2", None)),
    ],
)
def test_read_range(header, expected):
    assert read_range(header, 100) == expected


@pytest.mark.slow
@given(st.text(alphabet="bytes=-, 0123456789", max_size=30) | st.from_regex(r"bytes=\d{0,5}-\d{0,5}", fullmatch=True), st.integers(0, 2000))
def test_ranges_lie_in_file(header, size):
    found = read_range(header, size)
    assert found is None or 0 <= found[0] <= found[1] <= size


def test_range_of_file(url, package):
    content = (package / "textures.bin").read_bytes()
    status, headers, body = request(url, "/textures.bin", {"Range": "bytes=1000-2999", "Accept-Encoding": "gzip"})
    assert (status, body) == (206, content[1000:3000])
    assert headers["Content-Range"] == f"bytes 1000-2999/{len(content)}"
    assert headers["Accept-Ranges"] == "bytes"
    status, headers, body = request(url, "/textures.bin", {"Range": f"bytes={len(content)}-"})
    assert (status, headers["Content-Range"]) == (416, f"bytes */{len(content)}")
    assert content not in body
    assert request(url, "/textures.bin", {"Range": "bytes=0-1,4-5"})[::2] == (200, content)
    assert request(url, "/textures.bin", {"Range": "bytes=0-1"}, "HEAD")[::2] == (206, b"")


def test_changed_file_is_sent_completely(url, package):
    tag = request(url, "/mesh.bin", method="HEAD")[1]["ETag"]
    assert request(url, "/mesh.bin", {"Range": "bytes=0-9", "If-Range": tag})[0] == 206
    assert request(url, "/mesh.bin", {"Range": "bytes=0-9", "If-Range": '"other"'})[0] == 200
    assert request(url, "/mesh.bin", {"If-None-Match": f'"other", {tag}'})[::2] == (304, b"")


def test_text_is_compressed(url, package):
    status, headers, body = request(url, "/manifest.json", {"Accept-Encoding": "br, gzip", "Range": "bytes=0-3"})
    assert (status, headers["Content-Encoding"], headers["Vary"]) == (200, "gzip", "Accept-Encoding")
    assert gzip.decompress(body) == (package / "manifest.json").read_bytes()
    assert int(request(url, "/manifest.json", {"Accept-Encoding": "gzip"}, "HEAD")[1]["Content-Length"]) == len(body)


def test_other_methods_are_refused(url):
    for method in ("POST", "PUT", "DELETE", "TRACE", "PATCH"):
        status, headers, _ = request(url, "/mesh.bin", method=method)
        assert (status, headers["Allow"]) == (405, "GET, HEAD, OPTIONS")
    status, headers, body = request(url, "/mesh.bin", {"Origin": "http://example.org"}, "OPTIONS")
    assert (status, body, headers["Access-Control-Allow-Headers"]) == (204, b"", "Range, If-Range")


@pytest.mark.parametrize("path", PATH_TRICKS)
def test_path_tricks_find_nothing(url, path):
    answer = exchange(url, b"GET " + path.encode() + b" HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
    assert answer[:12] in (b"HTTP/1.1 404", b"HTTP/1.1 400", b"")
    assert SECRET not in answer


@settings(max_examples=200)
@given(
    st.binary(max_size=300)
    | st.text(max_size=80).map(lambda text: f"GET /{text} HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n".encode())
)
def test_random_requests_find_nothing(url, content):
    with socket.create_connection((urlsplit(url).hostname, urlsplit(url).port), timeout=20) as connection:
        connection.sendall(content)
        connection.shutdown(socket.SHUT_WR)
        answer = b""
        with suppress(ConnectionResetError):
            while part := connection.recv(65536):
                answer += part
    assert SECRET not in answer
    assert answer == b"" or answer.startswith(b"HTTP/1.1 ")


def test_requests_open_no_file(url):
    opened, is_recording = [], True

    def record(event: str, arguments: tuple) -> None:
        if is_recording and event == "open" and threading.current_thread().name == "package server":
            opened.append(arguments[0])

    sys.addaudithook(record)
    for path in ("/", "/mesh.bin", "/missing", "/%2e%2e/secret.txt", "/link.glb"):
        request(url, path)
    is_recording = False
    assert opened == []


def test_slow_requests_are_closed(url):
    start = time.monotonic()
    with socket.create_connection((urlsplit(url).hostname, urlsplit(url).port), timeout=20) as connection:
        with suppress(OSError):
            for byte in b"GET /mesh.bin HTTP/1.1\r\nHost: localhost\r\nX-Slow: " + b"a" * 1000:
                connection.send(bytes([byte]))
                time.sleep(0.05)
        assert connection.recv(1000) == b""
    assert time.monotonic() - start < 10.0


def test_long_headers_and_bodies_are_refused(url):
    for content in (b"GET /mesh.bin HTTP/1.1\r\nX: " + b"a" * 100_000, b"GET / HTTP/1.1\r\nHost: a\r\nContent-Length: 99999999\r\n\r\n"):
        assert b"200 OK" not in exchange(url, content + b"\r\n\r\n")


@pytest.mark.slow
def test_client_that_takes_nothing_is_closed(tmp_path):
    write_opaque_package(tmp_path, textures_size=30_000_000)
    with run_server(tmp_path, limits=ClientLimits(send_seconds=0.5)) as url:
        with socket.socket() as connection:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            connection.connect((urlsplit(url).hostname, urlsplit(url).port))
            connection.sendall(b"GET /textures.bin HTTP/1.1\r\nHost: localhost\r\n\r\n")
            time.sleep(1.5)
            connection.settimeout(20)
            taken = 0
            with suppress(ConnectionResetError):
                while part := connection.recv(1 << 20):
                    taken += len(part)
        assert taken < 30_000_000
        assert request(url, "/mesh.bin")[0] == 200


def test_hundred_clients_at_once(url, package):
    content = (package / "textures.bin").read_bytes()
    failures, gate = [], threading.Barrier(100)

    def load(seed: int) -> None:
        random = np.random.default_rng(seed)
        with closing(http.client.HTTPConnection(urlsplit(url).netloc, timeout=30)) as connection:
            connection.connect()
            gate.wait()
            for first in random.integers(0, len(content) - 500, 5):
                connection.request("GET", "/textures.bin", headers={"Range": f"bytes={first}-{first + 499}"})
                if connection.getresponse().read() != content[first : first + 500]:
                    failures.append(first)

    threads = [threading.Thread(target=load, args=(seed,)) for seed in range(100)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []


def test_more_connections_than_allowed_are_closed(tmp_path):
    write_opaque_package(tmp_path)
    with run_server(tmp_path, limits=ClientLimits(connections=2)) as url:
        address = (urlsplit(url).hostname, urlsplit(url).port)
        with socket.create_connection(address), socket.create_connection(address):
            time.sleep(0.2)
            with socket.create_connection(address, timeout=20) as third, suppress(ConnectionResetError):
                assert third.recv(100) == b""
        time.sleep(0.2)
        assert request(url, "/mesh.bin")[0] == 200


def test_parse_rate():
    assert parse_rate("2Mbit") == 250_000.0
    assert parse_rate("350 kbit/s") == 43_750.0
    assert parse_rate("1.5MB") == 1_500_000.0
    for text in ("", "0Mbit", "fast", "-1Mbit", "2", "2 Mbit per second", "1e9Mbit"):
        with pytest.raises(SettingsError, match="such as 2Mbit"):
            parse_rate(text)


def test_arrival_follows_steps_of_rate():
    connection = ConnectionRate(((1.0, 100.0), (1.0, 0.0), (1.0, 50.0)))
    assert connection.arrival(0.0, 50) == 0.5
    assert connection.arrival(0.5, 50) == 1.0
    assert connection.arrival(0.5, 100) == 3.0
    assert connection.arrival(5.0, 50) == 6.0
    with pytest.raises(SettingsError):
        ConnectionRate(((1.0, 0.0),))


@given(st.lists(st.tuples(st.floats(0.0, 2.0), st.floats(0.0, 1e4)), max_size=4), st.lists(st.integers(1, 1000), min_size=1, max_size=20))
def test_parts_arrive_when_their_sum_does(steps, sizes):
    connection = ConnectionRate((*steps, (1.0, 500.0)))
    position = 0.0
    for size in sizes:
        position = connection.arrival(position, size)
    assert position == pytest.approx(connection.arrival(0.0, sum(sizes)), rel=1e-9, abs=1e-6)


def test_rate_is_kept(tmp_path):
    write_opaque_package(tmp_path, textures_size=100_000)
    with run_server(tmp_path, connection=ConnectionRate(((1.0, 200_000.0),), latency=0.1)) as url:
        start = time.monotonic()
        request(url, "/textures.bin")
        assert 0.55 < time.monotonic() - start < 5.0


def test_incomplete_packages_are_refused(tmp_path):
    write_opaque_package(tmp_path)
    (tmp_path / "mesh.bin").write_bytes(b"short")
    with pytest.raises(FileError, match=r"mesh\.bin"), run_server(tmp_path):
        pass
    (tmp_path / "mesh.bin").unlink()
    with pytest.raises(FileError, match="is missing"), run_server(tmp_path):
        pass
    with pytest.raises(FileError), run_server(tmp_path / "missing"):
        pass


def test_used_port_is_an_error(url, package):
    with pytest.raises(FileError, match="choose another port"), run_server(package, port=urlsplit(url).port):
        pass
    with pytest.raises(FileError, match="choose another port"), run_server(package, address="not an address"):
        pass


@pytest.fixture(scope="module")
def local_server(package):
    server = LocalServer(package)
    yield server
    server.close()


class TestLocalServer:
    """The server of *View in Browser*, which needs no other package."""

    def test_files_and_ranges_of_the_package_are_sent(self, local_server, package):
        for name in ("manifest.json", "mesh.bin", "textures.bin", "levels.glb"):
            status, headers, body = request(local_server.url, f"/{name}?version")
            assert (status, body) == (200, (package / name).read_bytes()) and "Server" not in headers
        assert request(local_server.url, "/")[2] == read_page()["index.html"]
        content = (package / "mesh.bin").read_bytes()
        for header, status, expected in (("bytes=3-9", 206, content[3:10]), ("bytes=-4", 206, content[-4:]), ("bytes=9-3", 200, content)):
            answer, headers, body = request(local_server.url, "/mesh.bin", {"Range": header})
            assert (answer, body) == (status, expected)
        assert headers["Accept-Ranges"] == "bytes"
        status, headers, body = request(local_server.url, "/mesh.bin", {"Range": f"bytes={len(content)}-"})
        assert (status, headers["Content-Range"], body) == (416, f"bytes */{len(content)}", b"")

    @pytest.mark.parametrize("path", [path for path in PATH_TRICKS if path == path.strip()])  # Spaces belong to the request line.
    def test_nothing_else_is_sent(self, local_server, path):
        answer = exchange(local_server.url, f"GET {path} HTTP/1.1\r\nHost: localhost:1\r\nConnection: close\r\n\r\n".encode())
        assert SECRET not in answer and not answer.startswith(b"HTTP/1.1 2")

    def test_other_names_are_refused(self, local_server):
        for host, status in (("evil.example:80", 421), ("evil.example", 421), (urlsplit(local_server.url).netloc, 200)):
            assert request(local_server.url, "/manifest.json", {"Host": host})[0] == status

    def test_it_ends(self, package):
        server = LocalServer(package)
        server.close()
        with pytest.raises(OSError):
            request(server.url, "/")
