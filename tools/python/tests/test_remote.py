"""Archives on a web server: read by ranges, with the answers of the archive on disk."""

import os
import pickle
import re
import subprocess
import sys
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from conftest import FORKED, TOOTH

import isospan

ISOVALUE = 1000.5


class Ranges(SimpleHTTPRequestHandler):
    """Serves parts of files."""

    def do_GET(self):
        file = Path(self.translate_path(self.path))
        wanted = re.fullmatch(r"bytes=(\d*)-(\d*)", self.headers.get("Range", ""))
        if not file.is_file() or wanted is None:
            self.send_error(404 if not file.is_file() else 400)
            return
        size, (first, last) = file.stat().st_size, wanted.groups()
        lo = int(first) if first else max(0, size - int(last))
        hi = min(int(last) + 1 if first and last else size, size)
        with file.open("rb") as source:
            source.seek(lo)
            part = source.read(hi - lo)
        self.server.sent.append(len(part))
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {lo}-{hi - 1}/{size}")
        self.send_header("Content-Length", str(len(part)))
        self.send_header("Last-Modified", self.date_time_string(file.stat().st_mtime))
        self.end_headers()
        self.wfile.write(part)

    def log_message(self, *_about):
        pass


class Whole(SimpleHTTPRequestHandler):
    """Knows no ranges."""

    def log_message(self, *_about):
        pass


@pytest.fixture
def serve(tooth):
    """Starts a server of the archive's folder; gives it and the archive's address."""
    servers = []

    def start(kind):
        folder = Path(tooth.path).parent
        server = ThreadingHTTPServer(
            ("127.0.0.1", 0), lambda *given: kind(*given, directory=str(folder))
        )
        server.sent = []
        threading.Thread(target=server.serve_forever, daemon=True).start()
        servers.append(server)
        return server, f"http://127.0.0.1:{server.server_port}/{Path(tooth.path).name}"

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


def test_an_archive_on_a_web_server_answers_as_that_on_disk(tooth, serve):
    _, address = serve(Ranges)
    with isospan.open(address) as there:
        assert there.path == address and there.dims == tooth.dims
        here, surface = tooth.surface(ISOVALUE), there.surface(ISOVALUE)
        np.testing.assert_array_equal(surface.vertices, here.vertices)
        np.testing.assert_array_equal(surface.faces, here.faces)
        assert there.count(ISOVALUE) == tooth.count(ISOVALUE)
        assert there.range == tooth.range == there.spectrum().range
        points = [(10.5, 20, 30), (40, 40, 40)]
        np.testing.assert_array_equal(there.probe(points), tooth.probe(points))
        there.check()
        again = pickle.loads(pickle.dumps(there))
        assert again.count(400) == tooth.count(400)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks of POSIX")
def test_a_forked_child_asks_the_server_too(serve):
    _, address = serve(Ranges)
    command = [sys.executable, "-W", "ignore", "-c", FORKED, address]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def test_a_question_reads_a_part_of_the_archive(tooth, serve):
    server, address = serve(Ranges)
    path = Path(tooth.path).with_name("fine.isospan")
    fine = isospan.reduce(TOOTH, path, points="regular", fraction="1/4", chunk_points=20_000, measure=False)
    roi = "40:44,40:44,80:84"
    there = isospan.open(address.replace("tooth.isospan", path.name)).surface(ISOVALUE, roi=roi)
    here = fine.surface(ISOVALUE, roi=roi)
    np.testing.assert_array_equal(there.vertices, here.vertices)
    whole = sum(f.stat().st_size for f in path.rglob("*") if f.is_file())
    assert 0 < sum(server.sent) < whole / 2


def test_what_is_not_on_the_server_is_named(serve):
    _, address = serve(Ranges)
    with pytest.raises(isospan.Error, match="127.0.0.1") as caught:
        isospan.open(address.replace("tooth", "none"))
    assert "none.isospan" in str(caught.value)
    _, address = serve(Whole)
    with pytest.raises(isospan.Error, match="127.0.0.1"):
        isospan.open(address).surface(ISOVALUE)
