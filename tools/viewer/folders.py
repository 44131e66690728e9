"""Folders on a web server without programs, for tests of what `isospan publish` writes."""

import http.server
import pathlib
import re


class Whole(http.server.SimpleHTTPRequestHandler):
    """Files, always whole."""

    protocol_version = "HTTP/1.1"

    def log_message(self, *_):
        pass


class Ranges(Whole):
    """Files, and ranges of them."""

    def do_GET(self):
        wanted = re.fullmatch(r"bytes=(\d*)-(\d*)", self.headers.get("Range", ""))
        path = pathlib.Path(self.translate_path(self.path))
        if not wanted or not path.is_file() or (not wanted[1] and not self.server.knows_ends):
            return super().do_GET()
        length = path.stat().st_size
        first, last = (int(n) if n else None for n in wanted.groups())
        begin = max(0, length - last) if first is None else first
        end = length if first is None or last is None else min(length, last + 1)
        self.server.ranges += 1
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {begin}-{end - 1}/{length}")
        self.send_header("Content-Length", str(end - begin))
        self.end_headers()
        with path.open("rb") as file:
            file.seek(begin)
            self.wfile.write(file.read(end - begin))
