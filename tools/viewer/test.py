"""Tests of the viewer: the page in a headless Chromium, and requests that the server must refuse.

The page without a server is served by a few lines of Python, from a folder that `isospan publish` made.

Usage: test.py PROGRAM CHROMIUM TOOTH BALL OTHER FIELDS TUBE AXES SEVERAL LEVELS [FOLDER for screenshots]
"""

import concurrent.futures
import functools
import hashlib
import http.client
import http.server
import io
import json
import pathlib
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time

import numpy
from PIL import Image
from playwright.sync_api import sync_playwright

from folders import Ranges, Whole

PROGRAM, CHROMIUM, *ARCHIVES = sys.argv[1:11]
TOOTH, BALL, OTHER, FIELDS, TUBE, AXES, SEVERAL, _ = ARCHIVES
PICTURES = pathlib.Path(sys.argv[11]) if sys.argv[11:] and sys.argv[11] else None
MEMORY_MIB = 1536


class Server:
    """`isospan view`, until it is stopped."""

    def __enter__(self):
        command = [PROGRAM, "view", *ARCHIVES, "--json", "--memory", f"{MEMORY_MIB}MiB"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.url = json.loads(self.process.stdout.readline())["url"]
        self.port, self.token = re.fullmatch(r"http://127\.0\.0\.1:(\d+)/([0-9a-f]{32})/", self.url).groups()
        self.port = int(self.port)
        return self

    def __exit__(self, *_):
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(timeout=20) == 0, "Ctrl-C is how a server ends"

    def get(self, path, method="GET", host=None, timeout=60):
        """Status, headers and body of a request; `path` without the token's part."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=timeout)
        connection.request(method, path, headers={"Host": host} if host else {})
        answer = connection.getresponse()
        body = answer.read()
        connection.close()
        return answer.status, dict(answer.getheaders()), body

    def ask(self, path):
        return self.get(f"/{self.token}/{path}")

    def peak_mib(self):
        status = pathlib.Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.search(r"VmHWM:\s+(\d+) kB", status)[1]) / 1024


class Published:
    """A folder that `isospan publish` made, on a web server without programs, below some path."""

    def __init__(self, handler=Ranges, knows_ends=True):
        site = pathlib.Path("site/of somebody").absolute()
        if not site.exists():
            site.mkdir(parents=True)
            command = [PROGRAM, "publish", "-q", *ARCHIVES, "-o", site / "viewer", "--json"]
            report = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
            assert report["archives"] == ARCHIVES
            files = [f for f in (site / "viewer").rglob("*") if f.is_file()]
            assert (report["files"], report["bytes"]) == (len(files), sum(f.stat().st_size for f in files))
        handler = functools.partial(handler, directory=site.parent)
        self.http = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self.http.knows_ends, self.http.ranges = knows_ends, 0
        self.url = f"http://127.0.0.1:{self.http.server_port}/of%20somebody/viewer/"

    def __enter__(self):
        threading.Thread(target=self.http.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_):
        self.http.shutdown()
        self.http.server_close()


def parts_of(body):
    """The parts of an answer: what each says, and its bytes."""
    at = 0
    while at < len(body):
        (length,) = struct.unpack_from("<I", body, at)
        head = json.loads(body[at + 4 : at + 4 + length])
        at += 4 + length
        counts = [(24, "vertices"), (28, "changed"), (12, "triangles"), (8, "values")]
        size = sum(bytes_each * head.get(name, 0) for bytes_each, name in counts)
        yield head, body[at : at + size]
        assert at + size <= len(body), "the part is whole"
        at += size


def surface_of(body, coloured=False, number=0):
    """The report, vertices and triangles of one surface of an answer; and the values that colour it, where there are some."""
    vertices, triangles, values, report = numpy.empty((0, 6), "<f4"), numpy.empty((0, 3), "<u4"), None, None
    is_preview = False
    for head, content in parts_of(body):
        assert report is None, "the report comes last"
        if "report" in head:
            report = head["report"]
        elif head["surface"] != number:
            pass
        elif "values" in head:
            values = numpy.frombuffer(content, "<f8")
        else:
            if is_preview and not head["preview"]:
                # The finished surface takes the place of its preview.
                vertices, triangles = vertices[:0], triangles[:0]
            is_preview = head["preview"]
            added = 24 * head["vertices"]
            changes = added + 28 * head["changed"]
            vertices = numpy.concatenate([vertices, numpy.frombuffer(content[:added], "<f4").reshape(-1, 6)])
            numbers = numpy.frombuffer(content[added : added + 4 * head["changed"]], "<u4")
            vertices[numbers] = numpy.frombuffer(content[added + 4 * head["changed"] : changes], "<f4").reshape(-1, 6)
            triangles = numpy.concatenate([triangles, numpy.frombuffer(content[changes:], "<u4").reshape(-1, 3)])
            assert not len(triangles) or triangles.max() < len(vertices), "triangles have vertices that have come"
    assert not is_preview, "what comes last is no preview"
    counts = report["surfaces"][number]
    assert (len(vertices), len(triangles)) == (counts["vertices"], counts["triangles"])
    return (report, vertices, triangles, values) if coloured else (report, vertices, triangles)


def requests(server):
    """What programs may ask, and what they may not."""
    status, headers, page = server.ask("")
    assert status == 200 and b"<title>isospan</title>" in page
    assert "default-src 'none'" in headers["content-security-policy"]

    archives = json.loads(server.ask("archives")[2])
    assert [a["name"] for a in archives] == ARCHIVES
    assert [len(a["steps"]) for a in archives] == [1, 4, 1, 2, 2, 1, 6, 1]

    # The surface is that of the command line.
    report, vertices, triangles = surface_of(server.ask("1/surface?isovalues=0&step=1")[2])
    subprocess.run([PROGRAM, "surface", "-q", BALL, "-i", "0", "--step", "1", "-o", "ball.ply", "--force"], check=True,
                   stdout=subprocess.DEVNULL)
    ply = pathlib.Path("ball.ply").read_bytes()
    body = ply[ply.index(b"end_header\n") + 11 :]
    assert body.startswith(vertices.tobytes()), "vertices are those of the file"
    assert triangles.max() < len(vertices) and report["triangles"] > 300
    radius = numpy.linalg.norm((vertices[:, :3] - 11.5) * 2 / 23, axis=1)
    assert abs(radius - 0.5).max() < 0.05
    for form in ["glb", "stl", "ply", "obj", "vtp", "vtkhdf"]:
        status, _, file = server.ask(f"1/export?isovalues=0&step=1&format={form}")
        assert status == 200 and len(file) > 1000, form
    assert server.ask("1/export?isovalues=0&step=1&format=ply")[2] == ply

    # Surfaces come in parts, each with the triangles of some chunks; two of one answer are those of two answers.
    both = server.ask("2/surface?isovalues=500,900")[2]
    for number, isovalue in enumerate([500, 900]):
        chunks = [h["chunks"] for h, _ in parts_of(both) if h.get("surface") == number]
        assert len(chunks) > 3 and chunks == sorted(chunks), chunks
        found, alone = surface_of(both, number=number), surface_of(server.ask(f"2/surface?isovalues={isovalue}")[2])
        assert all((a == b).all() for a, b in zip(found[1:], alone[1:])), isovalue

    # Where a region cuts them, the parts are a preview, and the surface comes last.
    cut = server.ask("2/surface?isovalues=500&roi=0:50,0:50,0:99")[2]
    previews = [h["preview"] for h, _ in parts_of(cut) if "preview" in h]
    assert len(previews) > 3 and previews == [True] * (len(previews) - 1) + [False], previews
    surface_of(cut)

    # Another field at the vertices: the height.
    report, vertices, _, values = surface_of(server.ask("3/surface?isovalues=0&step=0&colour=1")[2], coloured=True)
    assert abs(values - (vertices[:, 2] * 2 / 23 - 1)).max() < 0.02 and values.max() - values.min() > 1
    command = [PROGRAM, "surface", "-q", FIELDS, "-i", "0", "--step", "ball", "--colour-by", "height", "--colour-map", "grey",
               "--colour-range", "0:1", "-o", "height.ply", "--force"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    export = "3/export?isovalues=0&step=0&colour=1&map=grey&range=0,1"
    assert server.ask(f"{export}&format=ply")[2] == pathlib.Path("height.ply").read_bytes()
    assert server.ask(f"{export}&format=stl")[0] == 200, "triangles of STL have no colours"

    # A plane through the middle: the distance from the centre is in the values.
    step = 23 / 32
    status, _, body = server.ask(f"1/slice?step=1&origin=0,0,11.5&u={step},0,0&v=0,{step},0&size=33,33")
    values = numpy.frombuffer(body, "<f8", 33 * 33, len(body) - 8 * 33 * 33).reshape(33, 33)
    # The tip of the cone is rounded off by the points; along x it falls by 1.
    assert status == 200 and abs(values[16, 16] - 0.5) < 0.1, values[16, 16]
    assert numpy.allclose(values[16, 20:31] , 0.5 - numpy.arange(4, 15) / 16, atol=0.05), values[16]

    # Grids with coordinates: a plane, a region and colours are those of the world. The field is the radius.
    for archive, radius in [(4, 1.5), (5, 5.0)]:
        lo, hi = json.loads(server.ask(f"{archive}/bounds")[2])
        report, vertices, _ = surface_of(server.ask(f"{archive}/surface?isovalues={radius}")[2])
        assert report["triangles"] > 500
        assert (vertices[:, :3] >= numpy.array(lo) - 1e-4).all() and (vertices[:, :3] <= numpy.array(hi) + 1e-4).all()
        middle = (lo[2] + hi[2]) / 2
        u, v = ((hi[a] - lo[a]) / 63 for a in (0, 1))
        body = server.ask(f"{archive}/slice?origin={lo[0]},{lo[1]},{middle}&u={u},0,0&v=0,{v},0&size=64,64")[2]
        values = numpy.frombuffer(body, "<f8", 64 * 64, len(body) - 8 * 64 * 64).reshape(64, 64)
        x, y = numpy.meshgrid(lo[0] + u * numpy.arange(64), lo[1] + v * numpy.arange(64))
        expected = numpy.hypot(x, y) if archive == 4 else numpy.sqrt(x**2 + y**2 + middle**2)
        there = ~numpy.isnan(values)
        assert there.mean() > 0.5 and abs(values - expected)[there].max() < (0.02 if archive == 4 else 0.6), archive
        if archive == 4:
            well_inside = (expected > 1.02) & (expected < 1.98)
            assert there[well_inside].all() and not there[(expected < 0.98) | (expected > 2.02)].any()
        roi = f"world:{(lo[0] + hi[0]) / 2}:,:,:"
        _, cut, _ = surface_of(server.ask(f"{archive}/surface?isovalues={radius}&roi={roi}")[2])
        assert 0 < len(cut) < len(vertices) and cut[:, 0].min() > (lo[0] + hi[0]) / 2 - 1e-4
    _, vertices, _, values = surface_of(server.ask("4/surface?isovalues=1.5&step=0&colour=1")[2], coloured=True)
    assert abs(values - vertices[:, 2]).max() < 0.02, "the height, of the tube"

    # Refusals.
    for path, expected in [
        ("/", 404),
        ("/0000/archives", 404),
        (f"/{server.token}", 404),
        (f"/{server.token}/../../etc/passwd", 404),
        (f"/{server.token}/..%2f..%2fetc%2fpasswd", 404),
        (f"/{server.token}/9/surface?isovalues=0", 400),
        (f"/{server.token}/x/surface?isovalues=0", 400),
        (f"/{server.token}/-1/surface?isovalues=0", 400),
        (f"/{server.token}/1/surface", 400),
        (f"/{server.token}/1/surface?isovalues=", 400),
        (f"/{server.token}/1/surface?isovalues=nan", 400),
        (f"/{server.token}/1/surface?isovalues=0,0", 400),
        (f"/{server.token}/1/surface?isovalues=" + ",".join(map(str, range(17))), 400),
        (f"/{server.token}/1/surface?isovalues=0&step=99", 400),
        (f"/{server.token}/1/surface?isovalues=0&roi=1:2", 400),
        (f"/{server.token}/7/surface?isovalues=600&level=9", 400),
        (f"/{server.token}/0/surface?isovalues=600&level=1", 400),
        (f"/{server.token}/1/slice?origin=0,0,0&u=1,0,0&v=0,1,0&size=100000,100000", 400),
        (f"/{server.token}/1/slice?origin=0,0,inf&u=1,0,0&v=0,1,0&size=4,4", 400),
        (f"/{server.token}/4/surface?isovalues=1.5&roi=world:100:101,:,:", 400),
        (f"/{server.token}/9/bounds", 400),
        (f"/{server.token}/1/export?isovalues=0&format=exe", 400),
        (f"/{server.token}/3/surface?isovalues=0&colour=2", 400),
        (f"/{server.token}/3/export?isovalues=0&colour=1&map=jet&format=ply", 400),
        (f"/{server.token}/3/export?isovalues=0&colour=1&range=1&format=ply", 400),
    ]:
        status, _, body = server.get(path)
        assert status == expected, (path, status, body)
        assert b"passwd" not in body or status == 404
    status, _, body = server.ask("1/surface?isovalues=0&step=99")
    assert b"steps 0 to 3" in body, body
    assert server.get(f"/{server.token}/archives", host="example.org")[0] == 421
    assert server.get(f"/{server.token}/archives", method="POST")[0] == 405
    assert server.get("/" + "a" * 100_000)[0] in (414, 431)


def crowds(server):
    """A slow reader, and a thousand at once: all wait or are refused, within the memory."""
    slow = socket.create_connection(("127.0.0.1", server.port))
    slow.sendall(f"GET /{server.token}/0/surface?isovalues=500 HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode())
    assert server.ask("1/surface?isovalues=0")[0] == 200, "others are answered meanwhile"

    def one(n):
        return server.get(f"/{server.token}/1/surface?isovalues={n / 5000}&step={n % 4}", timeout=120)[0]

    start = time.monotonic()
    with concurrent.futures.ThreadPoolExecutor(1000) as pool:
        found = list(pool.map(one, range(1000)))
    assert found == [200] * 1000, {s: found.count(s) for s in set(found)}
    slow.close()
    assert server.ask("1/surface?isovalues=0")[0] == 200
    print(f"1000 at once: answered in {time.monotonic() - start:.1f} s, peak {server.peak_mib():.0f} MiB")
    assert server.peak_mib() < MEMORY_MIB, server.peak_mib()


class Page:
    """A page of the browser that must be silent, and ask nobody else."""

    def __init__(self, browser, server, address="", is_ready=True, **options):
        self.server, self.wrong = server, []
        self.context = browser.new_context(**options)
        self.page = self.context.new_page()
        self.page.on("console", lambda m: m.type in ("error", "warning") and "GPU stall" not in m.text
                     and self.wrong.append(m.text))
        self.page.on("pageerror", lambda e: self.wrong.append(str(e)))
        self.page.on("request", lambda r: r.url.startswith((server.url, "data:", "blob:")) or self.wrong.append(r.url))
        self.page.goto(server.url + address)
        if is_ready:
            self.page.wait_for_selector("body[data-ready='1']")

    def shown(self, name="shown"):
        return int(self.page.evaluate(f"document.body.dataset.{name} ?? 0"))

    def after(self, act, name="shown", count=1):
        """Does something, and waits until the answers that it asks for are on the screen."""
        before = self.shown(name)
        act()
        self.until(before + count, name)
        self.page.wait_for_timeout(100)

    def until(self, count, name="shown"):
        """Waits for so many answers. Playwright's own waiting would want `eval`, which the page forbids."""
        end = time.monotonic() + 30
        while self.shown(name) < count:
            assert time.monotonic() < end, f"{self.shown(name)} of {count} {name}; {self.wrong}"
            self.page.wait_for_timeout(20)

    def statistics(self):
        rows = self.page.eval_on_selector_all("#statistics > *", "all => all.map(e => e.textContent)")
        return dict(zip(rows[::2], rows[1::2]))

    def numbers(self):
        """The statistics, when all of them are there."""
        end = time.monotonic() + 30
        while self.statistics()["volume inside"] == "…":
            assert time.monotonic() < end, f"{self.statistics()}; {self.wrong}"
            self.page.wait_for_timeout(20)
        return self.statistics()

    def triangles(self):
        return int(self.statistics()["triangles"].replace(",", ""))

    def set(self, selector, value):
        """Moves a slider, as a user does."""
        self.page.eval_on_selector(
            selector, f"e => {{ e.value = {value}; e.dispatchEvent(new Event('input', {{bubbles: true}})); }}")

    def picture(self, name):
        """The scene; kept where that is asked for."""
        self.page.wait_for_timeout(200)
        if PICTURES:
            PICTURES.mkdir(parents=True, exist_ok=True)
            self.page.screenshot(path=PICTURES / f"{name}.png")
        shot = self.page.locator("#view").screenshot()
        return numpy.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)

    def close(self):
        self.context.close()
        assert not self.wrong, self.wrong


def wide(browser, server):
    page = Page(browser, server, viewport={"width": 1280, "height": 800}, color_scheme="light", accept_downloads=True)
    # The tooth is seen: many pixels are neither paper nor lines.
    first = page.picture("wide")
    assert (abs(first - first[5, 5]).sum(axis=2) > 60).mean() > 0.05, "a surface is on the screen"
    before = page.triangles()
    page.after(lambda: page.set("#isovalue", 0.75))
    assert page.triangles() not in (0, before), "another isovalue, another surface"
    moved = page.picture("moved")
    assert abs(moved - first).sum(axis=2).astype(bool).mean() > 0.02
    # The keyboard moves it, too.
    page.page.focus("#scene")
    page.after(lambda: page.page.keyboard.press("]"))
    for keys in ("ArrowLeft", "ArrowUp", "+"):
        seen, address = page.picture("before the key"), page.page.url
        page.page.keyboard.press(keys)
        page.page.wait_for_function("old => location.href !== old", arg=address)
        page.page.wait_for_timeout(300)
        assert abs(page.picture("after the key") - seen).sum(axis=2).astype(bool).mean() > 0.01, keys
    # A second one, and each can be looked through.
    page.after(lambda: page.page.click("#add"))
    assert page.page.locator("#surfaces li").count() == 2
    page.picture("two")
    # A plane, with the field on it.
    page.after(lambda: page.page.select_option("#clip", "x"), "slices")
    page.page.wait_for_timeout(500)
    clipped = page.picture("plane")
    assert abs(clipped - moved).sum(axis=2).astype(bool).mean() > 0.02
    page.page.select_option("#map", "coolwarm")
    page.after(lambda: page.set("#place", 0.35), "slices")
    # The region is cut by the server.
    whole = page.triangles()
    page.after(lambda: page.set("#ranges input >> nth=2", 0.5), count=2)
    assert 0 < page.triangles() < whole
    page.picture("region")
    # A link gives the same view.
    page.page.click("#reset")
    again = Page(browser, server, "#" + page.page.url.split("#")[1], viewport={"width": 1280, "height": 800},
                 color_scheme="light")
    page.page.wait_for_timeout(500)
    again.page.wait_for_timeout(1000)
    assert again.triangles() == page.triangles()
    difference = abs(again.picture("again") - page.picture("linked")).sum(axis=2) > 30
    assert difference.mean() < 0.002, difference.mean()
    again.close()
    # What is seen is what is exported.
    for form in ["glb", "stl", "ply"]:
        with page.page.expect_download() as download:
            page.page.click(f"#{form}")
        file = pathlib.Path(download.value.path()).read_bytes()
        assert download.value.suggested_filename == f"tooth.{form}" and len(file) > 10_000
    with page.page.expect_download() as download:
        page.page.click("#png")
    picture = Image.open(download.value.path())
    assert picture.size[0] > 900 and len(picture.getcolors(1 << 24)) > 500
    # An isovalue that nothing has is said, and is no failure.
    page.after(lambda: page.page.fill("#surfaces input[type=number] >> nth=0", "99999") or
               page.page.keyboard.press("Tab"))
    assert "outside" in page.page.inner_text("#message")
    page.close()


def hostile_unit(browser, server):
    """The unit of an archive is text, whatever is in it."""
    page = Page(browser, server, "#archive=2", viewport={"width": 900, "height": 700}, color_scheme="light")
    assert page.page.text_content("section h2") == "Isovalue in <b>HU</b>"
    assert page.page.locator("b").count() == 0
    page.close()


def coloured(browser, server):
    """Surfaces show another field, and say so in the address."""
    page = Page(browser, server, "#archive=3&iso=0_d8cbb4_1", viewport={"width": 900, "height": 700}, color_scheme="light")
    plain = page.picture("plain")
    assert page.page.eval_on_selector_all("#by option", "all => all.map(o => o.textContent)") == [
        "their own colours", "ball", "height"]
    page.after(lambda: page.page.select_option("#by", label="height"))
    shown = page.picture("coloured")
    rows = numpy.nonzero((abs(plain - plain[5, 5]).sum(axis=2) > 60).sum(axis=1) > 40)[0]
    high, low = (shown[n, shown.shape[1] // 2] for n in (rows[len(rows) // 8], rows[-len(rows) // 8]))
    # The ball reaches from the blue of viridis to its green; the top lies higher.
    assert high[1] > high[2] and low[2] > low[1] and high[1] > low[1] + 40, (high, low)
    page.page.select_option("#map", "grey")
    grey = page.picture("grey")
    assert abs(grey - shown).sum(axis=2).astype(bool).mean() > 0.02
    again = Page(browser, server, "#" + page.page.url.split("#")[1], viewport={"width": 900, "height": 700},
                 color_scheme="light")
    again.page.wait_for_timeout(1000)
    assert (abs(again.picture("grey again") - grey).sum(axis=2) > 30).mean() < 0.002
    again.close()
    page.after(lambda: page.page.select_option("#by", label="their own colours"))
    assert (abs(page.picture("plain again") - plain).sum(axis=2) > 30).mean() < 0.002
    page.close()


def placed(browser, server):
    """Grids with coordinates: the plane, its slice, the region, colours, and a link to them."""
    page = Page(browser, server, "#archive=4", viewport={"width": 1000, "height": 700}, color_scheme="light")
    assert page.page.inner_text("#now") == "radius" and page.page.inner_text("#time h2") == "Field"
    assert not page.page.is_visible("#play"), "fields do not play"
    plain = page.picture("tube")
    page.after(lambda: page.page.select_option("#clip", "z"), "slices")
    page.page.wait_for_timeout(500)
    clipped = page.picture("tube plane")
    assert abs(clipped - plain).sum(axis=2).astype(bool).mean() > 0.02
    # The slice has the colours of viridis, from blue to yellow.
    blue, yellow = clipped[..., 2] - clipped[..., 0] > 40, clipped[..., 0] - clipped[..., 2] > 80
    assert blue.sum() > 500 and yellow.sum() > 500, (blue.sum(), yellow.sum())
    whole = page.triangles()
    page.after(lambda: page.set("#ranges input >> nth=0", 0.4))
    assert 0 < page.triangles() < whole
    slices = page.shown("slices")
    page.after(lambda: page.page.select_option("#by", label="height"))
    assert page.page.inner_text("#colours h2") == "Colours of height"
    page.until(slices + 2, "slices")
    page.page.fill("#high", "2")
    page.page.keyboard.press("Tab")
    page.page.wait_for_timeout(1000)
    shown = page.picture("tube coloured")
    again = Page(browser, server, "#" + page.page.url.split("#")[1], viewport={"width": 1000, "height": 700},
                 color_scheme="light")
    again.until(2, "slices")
    assert again.page.input_value("#by") == "1" and again.page.input_value("#high") == "2"
    difference = (abs(again.picture("tube again") - shown).sum(axis=2) > 30).mean()
    assert difference < 0.002, difference
    again.close()
    page.close()
    # A rectilinear grid, on a narrow page.
    page = Page(browser, server, "#archive=5&clip=x_0.5_0_1", viewport={"width": 360, "height": 740}, color_scheme="dark")
    page.page.wait_for_timeout(1000)
    shown = page.picture("axes")
    assert (abs(shown - shown[5, 5]).sum(axis=2) > 60).mean() > 0.03 and not page.page.is_visible("#time")
    page.close()


def several(browser, shown, server):
    """Of several fields at each step one is chosen; the page and its address name it."""
    options = dict(viewport={"width": 900, "height": 700}, color_scheme="light")
    page = Page(browser, shown, **options)
    assert not page.page.is_visible("#field")
    page.after(lambda: page.page.select_option("#archive", label=SEVERAL))
    assert page.page.is_visible("#field") and page.page.input_value("#field") == "ball"
    assert page.page.eval_on_selector_all("#field option", "all => all.map(o => o.textContent)") == ["ball", "height"]
    assert page.page.inner_text("#now") == "t = 0" and page.page.is_visible("#play")
    assert page.page.get_attribute("#step", "max") == "2" and page.page.inner_text("#colours h2") == "Colours of ball"
    page.after(lambda: page.set("#isovalue", 0.9))
    page.after(lambda: page.set("#step", 2))
    # The other field, at the same time: its own isovalue and range.
    page.after(lambda: page.page.select_option("#field", label="height"))
    assert page.page.inner_text("#now") == "t = 2" and page.page.inner_text("#colours h2") == "Colours of height"
    assert page.page.input_value("#low") == "11" and page.page.input_value("#high") == "13"
    isovalue = float(page.page.input_value("#surfaces input[type=number]"))
    assert 11 < isovalue < 13, isovalue
    parameters = f"isovalues={isovalue}&step=2&field=height"
    assert page.triangles() == surface_of(server.ask(f"6/surface?{parameters}")[2])[0]["triangles"] > 100
    page.after(lambda: page.page.select_option("#by", label="ball"))
    assert page.page.inner_text("#colours h2") == "Colours of ball"
    values = surface_of(server.ask(f"6/surface?{parameters}&colour=2&colour_field=ball")[2], coloured=True)[3]
    assert values.max() > 0.4 > values.min(), (values.min(), values.max())
    page.after(lambda: page.page.select_option("#clip", "x"), "slices", 2)
    seen, address = page.picture("several"), page.page.url.split("#")[1]
    assert "field=height" in address and "by=ball" in address, address
    again = Page(browser, shown, f"#{address}", **options)
    again.until(2, "slices")
    assert again.page.input_value("#field") == "height" and again.page.input_value("#by") == "ball"
    assert (abs(again.picture("several again") - seen).sum(axis=2) > 30).mean() < 0.002
    again.close()
    page.close()


def levels(browser, shown, server):
    """A coarse level of a pyramid is seen before the finest one, which another may replace."""
    options = dict(viewport={"width": 900, "height": 700}, color_scheme="light")
    triangles = {n: surface_of(server.ask(f"7/surface?isovalues=600&level={n}")[2])[0]["triangles"] for n in range(3)}
    assert triangles[0] > 2 * triangles[1] > 4 * triangles[2] > 0, triangles
    assert surface_of(server.ask("7/surface?isovalues=600")[2])[0]["triangles"] == triangles[0]
    page = Page(browser, shown, "#archive=7&iso=600_d8cbb4_1", **options)
    page.page.evaluate("window.asked = []; new PerformanceObserver((l) => asked.push(...l.getEntries().map((e) => e.name)))"
                       ".observe({ type: 'resource' })")
    assert page.triangles() == triangles[0]
    chosen = page.page.eval_on_selector_all("#level option", "all => all.map(o => o.textContent)")
    assert chosen[0].startswith("0: 103 × 94 × 161, error 1") and len(chosen) > 3, chosen
    if shown is server:
        page.after(lambda: page.set("#isovalue", 0.5))
        page.until(2)
        asked = page.page.evaluate("asked.filter((name) => name.includes('/surface?'))")
        assert ["level=2" in name for name in asked] == [True, False], asked
        page.page.fill("#surfaces input[type=number]", "600")
        page.after(lambda: page.page.press("#surfaces input[type=number]", "Enter"))
    page.after(lambda: page.page.select_option("#level", "1"))
    assert page.triangles() == triangles[1], (page.triangles(), triangles)
    address = page.page.url.split("#")[1]
    assert "level=1" in address, address
    page.picture("level 1")
    again = Page(browser, shown, f"#{address}", **options)
    assert again.triangles() == triangles[1] and again.page.input_value("#level") == "1"
    again.close()
    page.close()


def volume_of(step, isovalue):
    """The volume inside of an isosurface of the ball, as the program has it."""
    command = [PROGRAM, "spectrum", BALL, "--step", str(step), "--json"]
    knots = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)["knots"]
    return numpy.interp(isovalue, [k["isovalue"] for k in knots], [k["volume"] for k in knots])


def narrow(browser, server):
    page = Page(browser, server, "#archive=1", viewport={"width": 360, "height": 740}, color_scheme="dark",
                has_touch=True)
    assert page.page.evaluate("document.documentElement.scrollWidth") <= 360, "nothing is wider than the page"
    first = page.picture("narrow")
    assert first[5, 5].sum() < 200, "the page is dark"
    assert (abs(first - first[5, 5]).sum(axis=2) > 60).mean() > 0.03
    # Time: another step, then playing.
    area = page.statistics()["area"]
    # The spectrum of a step may come after its surface: no number is that of the step before.
    page.page.route("**/spectrum*", lambda route: (time.sleep(0.5), route.continue_()))
    page.after(lambda: page.set("#step", 3))
    statistics = page.numbers()
    assert statistics["area"] != area
    isovalue = float(page.page.input_value("#surfaces input[type=number]"))
    shown, true = float(statistics["volume inside"].split()[1].replace(",", "")), volume_of(3, isovalue)
    assert abs(shown / true - 1) < 1e-2, f"a volume of {shown}, where the program has {true}"
    assert abs(volume_of(0, isovalue) / true - 1) > 2e-2, "the steps differ, or nothing is tested"
    # Everything has its unit.
    assert statistics["area"].endswith(" µm²") and statistics["volume inside"].endswith(" µm³"), statistics
    assert statistics["error of the field, RMS"].endswith(" K") and statistics["error, largest"].endswith(" K"), statistics
    assert page.page.inner_text("#now") == "t = 1.5 s"
    assert page.page.text_content("section h2") == "Isovalue in K"
    assert page.page.get_attribute("#isovalue", "aria-valuetext").endswith(" K")
    assert page.page.text_content("#colours h2").endswith(" in K")
    page.page.eval_on_selector("#time", "e => e.scrollIntoView()")
    page.after(lambda: page.page.tap("#play"))
    before = page.shown()
    page.until(before + 4)
    page.page.tap("#play")
    page.picture("played")
    page.close()


# What the page gets, as a hash of its bytes.
TRIANGLES = """async ([archive, parameters]) => {
  const source = await import(new URL("source.js", location.href));
  const { vertices, values, triangles } = await source.surface(archive, parameters);
  const arrays = [vertices.used, values ?? new Float32Array(0), triangles.used];
  const parts = arrays.map((a) => new Uint8Array(a.buffer, a.byteOffset, a.byteLength));
  const all = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  parts.reduce((at, part) => (all.set(part, at), at + part.length), 0);
  const hash = new Uint8Array(await crypto.subtle.digest("SHA-256", all));
  return [triangles.length, [...hash].map((b) => b.toString(16).padStart(2, "0")).join("")];
}"""
SLICE = """async ([archive, parameters]) => {
  const source = await import(new URL("source.js", location.href));
  const { values } = await source.slice(archive, parameters);
  return [...new Uint8Array(values.buffer)];
}"""
FILE = """async ([archive, parameters]) => {
  const source = await import(new URL("source.js", location.href));
  const file = await source.file(archive, parameters);
  const hash = new Uint8Array(await crypto.subtle.digest("SHA-256", await file.arrayBuffer()));
  return [...hash].map((b) => b.toString(16).padStart(2, "0")).join("");
}"""
STOP = """async ([address, stops]) => {
  const names = document.querySelector('meta[name="isospan-archives"]').content.split("\\n");
  const worker = new Worker(new URL("worker.js", location.href));
  let pieces = 0;
  const ended = new Promise((done) => {
    worker.onmessage = ({ data }) => {
      if (!data.piece) return done(data);
      if (stops && pieces++ === 0) worker.postMessage({ stop: true });
    };
  });
  worker.postMessage({ names });
  worker.postMessage({ address });
  const { status, text } = await ended;
  worker.terminate();
  return [status, text];
}"""
ASK = """async (address) => {
  const { connect } = await import(new URL("local.js", location.href));
  const names = document.querySelector('meta[name="isospan-archives"]').content.split("\\n");
  const response = await connect(names)(address);
  return [response.status, await response.text()];
}"""


def same(page, server):
    """What WebAssembly answers is what the program answers, byte for byte."""
    cases = [(0, {"isovalues": v}) for v in [-5, 250.5, 600, 610, 1100, 600]]
    cases += [(1, {"isovalues": v, "step": n}) for n in range(4) for v in [0, 0.123]]
    cases += [(2, {"isovalues": v}) for v in [333, 900]]
    cases += [(0, {"isovalues": 600, "cap": "true"}),
              (0, {"isovalues": 600, "roi": "world:10:70,:,20.5:100"}), (2, {"isovalues": 500, "roi": "0:50,0:50,0:99"}),
              (1, {"isovalues": 0.2, "step": 2, "cap": "true"}), (3, {"isovalues": 0.1, "step": 0, "colour": 1}), (4, {"isovalues": 1.5}), (5, {"isovalues": 5}),
              (4, {"isovalues": 1.5, "step": 0, "colour": 1, "roi": "world:0.5:,:,:"})]
    cases += [(6, {"isovalues": v, "step": n, "field": field, "colour": n, "colour_field": other})
              for n in range(3) for field, other, v in [("ball", "height", 0.1), ("height", "ball", 10.5 + n)]]
    for archive, parameters in cases:
        query = "&".join(f"{k}={v}" for k, v in parameters.items())
        status, _, body = server.ask(f"{archive}/surface?{query}")
        assert status == 200, (query, body)
        report, vertices, triangles, values = surface_of(body, coloured=True)
        found = page.evaluate(TRIANGLES, [archive, parameters])
        content = vertices.tobytes() + (b"" if values is None else values.tobytes()) + triangles.tobytes()
        expected = [3 * report["triangles"], hashlib.sha256(content).hexdigest()]
        assert found == expected, f"{archive} {parameters}: run tools/viewer/wasm; {found}, expected {expected}"
    of_fields = [{}] * 6 + [{"step": 2, "field": "ball"}, {"step": 2, "field": "height"}]
    for n, (isovalue, moment) in enumerate(zip([600, 0.1, 600, 0.1, 1.5, 5, 0.1, 12.5], of_fields)):
        archive, which = min(n, 6), "&".join(f"{k}={v}" for k, v in moment.items())
        parameters = {"step": 0, "origin": "1,2,11.5", "u": "0.7,0,0", "v": "0,0.7,0.1", "size": "31,27"} | moment
        query = "&".join(f"{k}={v}" for k, v in parameters.items())
        body = server.ask(f"{archive}/slice?{query}")[2]
        (length,) = struct.unpack_from("<I", body)
        assert bytes(page.evaluate(SLICE, [archive, parameters])) == body[4 + length :], (archive, moment)
        status, text = page.evaluate(ASK, f"{archive}/spectrum?{which}")
        expected = json.loads(server.ask(f"{archive}/spectrum?{which}")[2])
        assert status == 200 and json.loads(text)["knots"] == expected["knots"], (archive, moment)
        status, text = page.evaluate(ASK, f"{archive}/bounds")
        assert status == 200 and json.loads(text) == json.loads(server.ask(f"{archive}/bounds")[2])
        for form in ["glb", "stl", "ply"]:
            wish = {"isovalues": isovalue, "format": form} | moment
            expected = server.ask(f"{archive}/export?" + "&".join(f"{k}={v}" for k, v in wish.items()))[2]
            assert page.evaluate(FILE, [archive, wish]) == hashlib.sha256(expected).hexdigest(), (archive, wish)
    wish = {"isovalues": "0.1", "step": 0, "colour": 1, "map": "grey", "range": "0,1", "format": "glb"}
    expected = server.ask("3/export?" + "&".join(f"{k}={v}" for k, v in wish.items()))[2]
    assert page.evaluate(FILE, [3, wish]) == hashlib.sha256(expected).hexdigest()
    for address in ["0/surface?isovalues=nan", "0/surface", "9/spectrum", "0/export?isovalues=0&format=exe", "0/surface?isovalues=0&step=9",
                    "6/spectrum?step=1", "6/spectrum?step=1&field=none"]:
        status, text = page.evaluate(ASK, address)
        assert status == 400 and text, (address, status, text)


def stopped(page):
    """The worker ends an answer that is no longer wanted, where it can wait for the wish."""
    address = "2/surface?isovalues=500"
    assert page.evaluate(STOP, [address, False])[0] == 200
    status, text = page.evaluate(STOP, [address, True])
    waits = page.evaluate("typeof WebAssembly.Suspending === 'function'")
    assert (status != 200) == waits, (status, text, waits)


def without_a_server(browser, server):
    """The published folder: the same page, the same answers."""
    # What is wrong with a program is said before what is wrong with a folder.
    run = subprocess.run([PROGRAM, "publish", *ARCHIVES, "-o", "."], stderr=subprocess.PIPE, text=True)
    if "without the page's WebAssembly" in run.stderr:
        print(f"the viewer's page without a server is not tested: {run.stderr.strip()}", file=sys.stderr)
        return
    with Published() as published:
        wide(browser, published)
        narrow(browser, published)
        hostile_unit(browser, published)
        coloured(browser, published)
        placed(browser, published)
        several(browser, published, server)
        levels(browser, published, server)
        page = Page(browser, published)
        same(page.page, server)
        stopped(page.page)
        page.close()
        assert published.http.ranges > 20
    # A server that knows no ends of files, as some stores do.
    with Published(knows_ends=False) as published:
        Page(browser, published).close()
    # One that knows no ranges: it sends whole files, which are kept.
    with Published(Whole) as published:
        Page(browser, published).close()
    # An archive that is not there.
    with Published() as published:
        ball = pathlib.Path("site/of somebody/viewer") / BALL / "manifest.zst"
        ball.rename(ball.with_name("gone"))
        page = Page(browser, published, is_ready=False)
        page.page.wait_for_selector("#message:not([hidden], .loading)")
        assert "manifest.zst" in page.page.inner_text("#message"), page.page.inner_text("#message")
        page.wrong = [line for line in page.wrong if "404" not in line]
        page.close()


def main():
    with Server() as server, sync_playwright() as playwright:
        requests(server)
        arguments = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
                     "--disable-dev-shm-usage", "--disable-background-networking", "--disable-component-update",
                     "--disable-sync"]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        wide(browser, server)
        narrow(browser, server)
        hostile_unit(browser, server)
        coloured(browser, server)
        placed(browser, server)
        several(browser, server, server)
        levels(browser, server, server)
        without_a_server(browser, server)
        browser.close()
        crowds(server)
    print("the viewer: all good")


main()
