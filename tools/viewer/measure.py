"""How fast a new isovalue is on the screen: the first part of the surface, and all of it, until the meshes are handed to GL.

Usage: measure.py PROGRAM CHROMIUM ARCHIVE [published]
"""

import functools
import http.server
import json
import pathlib
import subprocess
import sys
import tempfile
import threading

from playwright.sync_api import sync_playwright

from folders import Ranges

PROGRAM, CHROMIUM, ARCHIVE = sys.argv[1:4]
IS_PUBLISHED = sys.argv[4:] == ["published"]
# Shares of the range: a large step, then small ones to and fro, as a slider is dragged.
PLACES = [0.3, 0.31, 0.32, 0.33, 0.32, 0.31, 0.3, 0.5, 0.505, 0.51, 0.505, 0.5]


def statistics(page):
    rows = page.eval_on_selector_all("#statistics > *", "all => all.map(e => e.textContent)")
    return dict(zip(rows[::2], rows[1::2]))


def measure(url):
    arguments = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(url)
        page.wait_for_selector("body[data-ready='1']", timeout=120_000)
        print(f"{'place':>6} {'triangles':>12} {'extraction':>12} {'first part':>12} {'all':>12}")
        for place in PLACES:
            before = page.evaluate("Number(document.body.dataset.shown)")
            page.eval_on_selector(
                "#isovalue", f"e => {{ e.value = {place}; e.dispatchEvent(new Event('input', {{bubbles: true}})); }}")
            while page.evaluate("Number(document.body.dataset.shown)") == before:
                page.wait_for_timeout(20)
            # Until it is drawn, too.
            page.wait_for_timeout(500)
            found = statistics(page)
            print(f"{place:6} {found['triangles']:>12} {found['extraction']:>12} {found['first part']:>12} "
                  f"{found['until drawn']:>12}")
        print("peak of the page's heap:", page.evaluate("performance.memory.usedJSHeapSize") >> 20, "MiB")
        browser.close()


def main():
    if not IS_PUBLISHED:
        server = subprocess.Popen([PROGRAM, "view", ARCHIVE, "--json"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                                  text=True)
        measure(json.loads(server.stdout.readline())["url"])
        server.terminate()
        return
    with tempfile.TemporaryDirectory() as folder:
        site = pathlib.Path(folder) / "site"
        subprocess.run([PROGRAM, "publish", "-q", ARCHIVE, "-o", site], check=True, stdout=subprocess.DEVNULL)
        handler = functools.partial(Ranges, directory=site)
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
        server.knows_ends, server.ranges = True, 0
        threading.Thread(target=server.serve_forever, daemon=True).start()
        measure(f"http://127.0.0.1:{server.server_port}/")
        server.shutdown()


main()
