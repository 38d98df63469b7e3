"""Headless Chromium without a network: a page is opened here, and posts to `/found` what a script in it has found."""

from __future__ import annotations

import functools
import http.server
import json
import os
import queue
import signal
import subprocess
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from programs import SANDBOX, find_program

_SCHEMES = {"light": 1, "dark": 0}
"""Chromium's numbers of `prefers-color-scheme`."""


class Served(NamedTuple):
    """A page as the browser gets it."""

    html: str
    policy: str = ""
    """Content-Security-Policy: what the page would load against it is an error."""


def ask(
    pages: Mapping[str, Served], folder: Path | None = None, *, scheme: str = "light", timeout: float = 60.0
) -> tuple[Any, list[str]]:
    """What the page at `/` and those that it opens post to `/found` first, and the lines of the browser's console.

    pages: by path; folder: where files at other paths lie; scheme: "light" or "dark"; timeout: s.
    """
    answers: queue.Queue[Any] = queue.Queue()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        handler = functools.partial(_Handler, pages, answers, directory=str(folder or profile))
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with open(f"{profile}/log", "w+b") as log:
            command = _command(
                profile, scheme, "--window-size=1500,1000", "--enable-logging=stderr", "--remote-debugging-port=0",
                f"http://127.0.0.1:{server.server_port}/",
            )  # fmt: skip
            browser = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
            try:
                answer = answers.get(timeout=timeout)
            finally:
                os.killpg(browser.pid, signal.SIGKILL)
                browser.wait()
                server.shutdown()
                server.server_close()
            log.seek(0)
            messages = [line for line in log.read().decode(errors="replace").splitlines() if "CONSOLE" in line]
    return answer, messages


def shoot(url: str, png: Path, size: tuple[int, int], *, scheme: str = "light", timeout: float = 60.0) -> None:
    """Write a picture of an address; size: (width, height) of the window, px."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = _command(
            profile, scheme, f"--window-size={size[0]},{size[1]}", "--virtual-time-budget=4000",
            "--run-all-compositor-stages-before-draw", f"--screenshot={png}", url,
        )  # fmt: skip
        subprocess.run(command, capture_output=True, timeout=timeout, check=True)


def _command(profile: str, scheme: str, *options: str) -> list[str]:
    """own: a folder for what the browser keeps."""
    return [
        find_program("chromium"), "--headless", "--disable-gpu", "--hide-scrollbars", "--mute-audio", "--no-first-run",
        "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1", f"--user-data-dir={profile}/profile",
        f"--blink-settings=preferredColorScheme={_SCHEMES[scheme]}",
        *SANDBOX, *options,
    ]  # fmt: skip


class _Handler(http.server.SimpleHTTPRequestHandler):
    """Gives pages, and files of a folder; takes what was found."""

    def __init__(self, pages: Mapping[str, Served], answers: queue.Queue[Any], *arguments: Any, **options: Any) -> None:
        self._pages, self._answers = pages, answers
        super().__init__(*arguments, **options)

    def do_GET(self) -> None:
        """A page, or a file."""
        page = self._pages.get(self.path)
        if page is None:
            super().do_GET()
            return
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        if page.policy:
            self.send_header("Content-Security-Policy", page.policy)
        self.end_headers()
        self.wfile.write(page.html.encode())

    def do_POST(self) -> None:
        """What was found."""
        self._answers.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *words: Any) -> None:
        """Nothing."""
