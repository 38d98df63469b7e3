"""Chromium and Firefox without a window, driven as a user drives them: keys, pointer, sizes, colours, pictures.

Chromium is spoken to in the DevTools protocol over a pipe, Firefox in Marionette's over a socket; neither needs more
than the browser. Both offer: `open`, `run`, `wait`, `press`, `write`, `click`, `resize`, `said`, `requests`.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import browser
from programs import find_program

_KEYS = {
    "Tab": ("Tab", 9, ""), "Enter": ("Enter", 13, "\r"), " ": ("Space", 32, " "), "Escape": ("Escape", 27, ""),
    "ArrowLeft": ("ArrowLeft", 37, ""), "ArrowUp": ("ArrowUp", 38, ""), "ArrowRight": ("ArrowRight", 39, ""),
    "ArrowDown": ("ArrowDown", 40, ""), "Home": ("Home", 36, ""), "End": ("End", 35, ""),
}  # fmt: skip
"""key: (code, virtual key code, text)"""
_PIPES = """
import os, sys
given = [os.dup(int(each)) for each in sys.argv[1:3]]
given = [os.dup(os.dup(each)) for each in given]
for place, each in zip((3, 4), given): os.dup2(each, place)
os.execv(sys.argv[3], sys.argv[3:])
"""
"""Chromium reads from descriptor 3 and writes to 4."""


class Failed(AssertionError):
    """A script in the page raised."""


class Media(NamedTuple):
    """What the reader has asked of pages."""

    scheme: str = "light"
    still: bool = False
    """prefers-reduced-motion"""


LIGHT = Media()


def _end(process: subprocess.Popen[Any]) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


class Chromium:
    """A page in headless Chromium.

    scale: device pixels a pixel; touch: a finger, no mouse.
    """

    name = "chromium"

    def __init__(
        self, size: tuple[int, int] = (1400, 900), media: Media = LIGHT, *, scale: float = 1.0, touch: bool = False,
        timeout: float = 60.0,
    ) -> None:  # fmt: skip
        self.timeout, self._events, self._number, self._rest = timeout, [], 0, b""
        self._own = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        (there_in, self._out), (self._in, there_out) = os.pipe(), os.pipe()
        command = browser._command(self._own.name, media.scheme, "--remote-debugging-pipe", "about:blank")
        launcher = [sys.executable, "-I", "-c", _PIPES, str(there_in), str(there_out), *command]
        with open(f"{self._own.name}/log", "wb") as log:
            self._process = subprocess.Popen(
                launcher, pass_fds=(there_in, there_out), stdout=log, stderr=log, start_new_session=True
            )
        os.close(there_in)
        os.close(there_out)
        pages = self._call("Target.getTargets", session="")["targetInfos"]
        page = next(target["targetId"] for target in pages if target["type"] == "page")
        self._session = self._call("Target.attachToTarget", session="", targetId=page, flatten=True)["sessionId"]
        self._scale, self._touch = scale, touch
        for name in ("Page", "Runtime", "Log", "Network"):
            self._call(f"{name}.enable")
        # workers ask for things too
        self._call("Target.setAutoAttach", autoAttach=True, waitForDebuggerOnStart=False, flatten=True)
        self.resize(*size)
        self.media(media)
        if touch:
            self._call("Emulation.setTouchEmulationEnabled", enabled=True)

    def __enter__(self) -> Chromium:
        return self

    def __exit__(self, *_: object) -> None:
        _end(self._process)
        os.close(self._in)
        os.close(self._out)
        self._own.cleanup()

    # -- the protocol
    def _call(self, method: str, *, session: str | None = None, **parameters: Any) -> Any:
        number = self._send(method, parameters, self._session if session is None else session)
        until = time.monotonic() + self.timeout
        while True:
            answer = self._next(until)
            if answer.get("id") == number:
                if "error" in answer:
                    raise Failed(f"{method}: {answer['error']['message']}")
                return answer["result"]
            self._took(answer)

    def _send(self, method: str, parameters: dict[str, Any], session: str) -> int:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        content = json.dumps(message).encode() + b"\0"
        while content:
            content = content[os.write(self._out, content) :]
        return self._number

    def _next(self, until: float) -> dict[str, Any]:
        while b"\0" not in self._rest:
            if not select.select([self._in], [], [], max(0.0, until - time.monotonic()))[0]:
                raise TimeoutError(f"Chromium is silent: {Path(f'{self._own.name}/log').read_text()[-2000:]}")
            chunk = os.read(self._in, 1 << 20)
            if not chunk:
                raise Failed(f"Chromium has ended: {Path(f'{self._own.name}/log').read_text()[-2000:]}")
            self._rest += chunk
        message, self._rest = self._rest.split(b"\0", 1)
        return json.loads(message)

    def _took(self, event: dict[str, Any]) -> None:
        if event.get("method") == "Target.attachedToTarget":  # a worker
            for name in ("Runtime", "Log", "Network"):
                self._send(f"{name}.enable", {}, event["params"]["sessionId"])
        if "method" in event:
            self._events.append(event)

    # -- what a user does
    def open(self, url: str) -> None:
        """Go to an address and wait until it is loaded."""
        self._events.clear()
        self.run("window.left = true")
        if "loaderId" in self._call("Page.navigate", url=url):  # another document
            self.wait("document.readyState === 'complete' && !window.left")

    def run(self, script: str) -> Any:
        """The value of an expression in the page, waited for."""
        answer = self._call(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True, userGesture=True
        )
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            raise Failed(details.get("exception", {}).get("description") or details["text"])
        return answer["result"].get("value")

    def wait(self, condition: str, seconds: float | None = None) -> Any:
        """The value of an expression as soon as it is true."""
        return _wait(self, condition, seconds)

    def press(self, key: str, *, shift: bool = False, control: bool = False, times: int = 1) -> None:
        """A key, down and up."""
        code, number, text = _KEYS.get(key, (f"Key{key.upper()}", ord(key.upper()[0]), key))
        event = {"key": key, "code": code, "windowsVirtualKeyCode": number, "modifiers": 8 * shift + 2 * control}
        for _ in range(times):
            self._call("Input.dispatchKeyEvent", type="keyDown", **event, **({"text": text} if text else {}))
            self._call("Input.dispatchKeyEvent", type="keyUp", **event)

    def write(self, text: str) -> None:
        """Text at the cursor."""
        self._call("Input.insertText", text=text)

    def click(self, x: float, y: float, *, to: tuple[float, float] | None = None) -> None:
        """The left button at a place (px); to: where it is let go."""
        at = {"button": "left", "clickCount": 1, "buttons": 1}
        self._call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        self._call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **at)
        for k in range(1, 9) if to else ():
            between = (x + (to[0] - x) * k / 8, y + (to[1] - y) * k / 8)
            self._call("Input.dispatchMouseEvent", type="mouseMoved", x=between[0], y=between[1], **at)
        x, y = to or (x, y)
        self._call("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, **at)

    def point(self, x: float, y: float) -> None:
        """The pointer goes to a place (px)."""
        self._call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    def resize(self, width: int, height: int) -> None:
        """Of the page, px."""
        self._call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=self._scale,
            mobile=self._touch,
        )  # fmt: skip

    def media(self, media: Media) -> None:
        """What the reader asks for."""
        features = [{"name": "prefers-color-scheme", "value": media.scheme}]
        features += [{"name": "prefers-reduced-motion", "value": "reduce" if media.still else "no-preference"}]
        self._call("Emulation.setEmulatedMedia", features=features)

    # -- what came of it
    def shoot(self, file: Path) -> None:
        """Write what the window shows as a PNG."""
        file.write_bytes(base64.b64decode(self._call("Page.captureScreenshot")["data"]))

    def said(self) -> list[str]:
        """What the page and its workers wrote to the console, and what they raised."""
        self.run("0")
        messages = []
        for event in self._events:
            params = event.get("params", {})
            if event["method"] == "Runtime.consoleAPICalled":
                messages.append(
                    " ".join(str(argument.get("value", argument.get("description"))) for argument in params["args"])
                )
            elif event["method"] == "Runtime.exceptionThrown":
                details = params["exceptionDetails"]
                messages.append(details.get("exception", {}).get("description") or details["text"])
            elif event["method"] == "Log.entryAdded":
                messages.append(f"{params['entry']['text']} {params['entry'].get('url', '')}")
        return messages

    def requests(self) -> list[str]:
        """The addresses that were loaded, but for the page itself and what lies in it."""
        self.run("0")
        sent_requests = [event["params"] for event in self._events if event["method"] == "Network.requestWillBeSent"]
        return [
            request["request"]["url"] for request in sent_requests
            if request["type"] != "Document" and not request["request"]["url"].startswith(("data:", "blob:"))
        ]  # fmt: skip


class Firefox:
    """A page in headless Firefox."""

    name = "firefox"

    def __init__(self, size: tuple[int, int] = (1400, 900), media: Media = LIGHT, *, timeout: float = 60.0) -> None:
        self.timeout, self._number, self._rest = timeout, 0, b""
        self._own = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        profile = Path(self._own.name)
        preferences = {
            "marionette.port": 0, "browser.shell.checkDefaultBrowser": False, "app.update.enabled": False,
            "datareporting.policy.dataSubmissionEnabled": False, "network.captive-portal-service.enabled": False,
            "network.connectivity-service.enabled": False, "ui.prefersReducedMotion": int(media.still),
            "layout.css.prefers-color-scheme.content-override": int(media.scheme == "light"),
            "browser.startup.homepage_override.mstone": "ignore", "toolkit.telemetry.enabled": False,
            "network.proxy.type": 0, "devtools.console.stdout.content": True, "dom.disable_open_during_load": False,
        }  # fmt: skip
        lines = [f"user_pref({json.dumps(name)}, {json.dumps(value)});" for name, value in preferences.items()]
        (profile / "user.js").write_text("\n".join(lines))
        self._log = open(profile / "log", "wb")  # noqa: SIM115
        command = [
            find_program("firefox"), "--headless", "--no-remote", "--marionette", "--remote-allow-system-access",
            "--profile", str(profile), "about:blank",
        ]  # fmt: skip
        places = {**os.environ, "HOME": self._own.name, "MOZ_DISABLE_CONTENT_SANDBOX": "1"}
        self._process = subprocess.Popen(
            command, stdout=self._log, stderr=self._log, env=places, start_new_session=True
        )
        until = time.monotonic() + timeout
        port = profile / "MarionetteActivePort"
        while not (port.exists() and port.read_text().strip()):
            if time.monotonic() > until or self._process.poll() is not None:
                raise TimeoutError(f"Firefox does not listen: {(profile / 'log').read_text()[-2000:]}")
            time.sleep(0.05)
        self._socket = socket.create_connection(("127.0.0.1", int(port.read_text())), timeout)
        self._receive()
        self._call("WebDriver:NewSession", {"capabilities": {"alwaysMatch": {"acceptInsecureCerts": False}}})
        self._call("WebDriver:SetTimeouts", {"script": int(1000 * timeout), "pageLoad": int(1000 * timeout)})
        self.resize(*size)

    def __enter__(self) -> Firefox:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        _end(self._process)
        self._log.close()
        self._own.cleanup()

    # -- the protocol: LENGTH:[0, id, command, parameters], and LENGTH:[1, id, error, result]
    def _receive(self) -> Any:
        while b":" not in self._rest:
            self._rest += self._socket.recv(1 << 16)
        size, self._rest = self._rest.split(b":", 1)
        while len(self._rest) < int(size):
            self._rest += self._socket.recv(1 << 20)
        message, self._rest = self._rest[: int(size)], self._rest[int(size) :]
        return json.loads(message)

    def _call(self, command: str, parameters: dict[str, Any] | None = None) -> Any:
        self._number += 1
        text = json.dumps([0, self._number, command, parameters or {}]).encode()
        self._socket.sendall(b"%d:%s" % (len(text), text))
        _, _, error, result = self._receive()
        if error:
            raise Failed(f"{command}: {error['message']}")
        return result

    # -- what a user does
    def open(self, url: str) -> None:
        self._call("Marionette:SetContext", {"value": "chrome"})
        self._script("Services.console.reset();")
        self._call("Marionette:SetContext", {"value": "content"})
        self._call("WebDriver:Navigate", {"url": url})

    def _script(self, body: str) -> Any:
        return self._call("WebDriver:ExecuteScript", {"script": body, "args": [], "newSandbox": False})["value"]

    def run(self, script: str) -> Any:
        # `eval` would be refused by the page's policy
        body = f"return (async () => {{ return await ({script}); }})();"
        return self._call("WebDriver:ExecuteScript", {"script": body, "args": [], "sandbox": None})["value"]

    def wait(self, condition: str, seconds: float | None = None) -> Any:
        return _wait(self, condition, seconds)

    def press(self, key: str, *, shift: bool = False, times: int = 1) -> None:
        codes = {"Tab": "\ue004", "Enter": "\ue007", "Escape": "\ue00c", "ArrowLeft": "\ue012", "ArrowUp": "\ue013",
                 "ArrowRight": "\ue014", "ArrowDown": "\ue015", "Home": "\ue011", "End": "\ue010"}  # fmt: skip
        value = codes.get(key, key)
        steps = [{"type": "keyDown", "value": value}, {"type": "keyUp", "value": value}] * times
        if shift:
            steps = [{"type": "keyDown", "value": "\ue008"}, *steps, {"type": "keyUp", "value": "\ue008"}]
        self._call("WebDriver:PerformActions", {"actions": [{"type": "key", "id": "keys", "actions": steps}]})

    def write(self, text: str) -> None:
        for character in text:
            self.press(character)

    def click(self, x: float, y: float) -> None:
        steps = [{"type": "pointerMove", "x": int(x), "y": int(y)}, {"type": "pointerDown", "button": 0},
                 {"type": "pointerUp", "button": 0}]  # fmt: skip
        self._call("WebDriver:PerformActions", {"actions": [{"type": "pointer", "id": "mouse", "actions": steps}]})

    def resize(self, width: int, height: int) -> None:
        """Of the page, px; Firefox has a least width of its window."""
        for _ in range(2):
            inner = self._script("return [outerWidth - innerWidth, outerHeight - innerHeight];")
            self._call("WebDriver:SetWindowRect", {"width": width + inner[0], "height": height + inner[1]})

    # -- what came of it
    def said(self) -> list[str]:
        self._call("Marionette:SetContext", {"value": "chrome"})
        messages = self._script(
            "return Services.console.getMessageArray().filter(m => m instanceof Ci.nsIScriptError"
            " && (m.sourceName || '').match(/^(file|http|blob|data)/)).map(m => m.errorMessage);"
        )
        self._call("Marionette:SetContext", {"value": "content"})
        self._log.flush()
        log = (Path(self._own.name) / "log").read_text(errors="replace").splitlines()
        # the second is the browser's own
        return [*messages, *(line for line in log if line.startswith("console.") and "RSLoader" not in line)]

    def requests(self) -> list[str]:
        return self._script(
            "return performance.getEntriesByType('resource').map(e => e.name).filter(n => !/^(data|blob):/.test(n));"
        )


def _wait(page: Any, condition: str, seconds: float | None) -> Any:
    until = time.monotonic() + (page.timeout if seconds is None else seconds)
    while True:
        value = page.run(condition)
        if value:
            return value
        if time.monotonic() > until:
            raise TimeoutError(f"never true: {condition}")
        time.sleep(0.02)


BROWSERS = {"chromium": Chromium, "firefox": Firefox}
"""The class of each browser."""
