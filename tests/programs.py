"""Compilers, emulators and browsers that tests run. A program that fails at a small task counts as missing.

A test that needs one has the mark `needs`, or takes its path from `find_program`; without a working one it is skipped,
and the reason says what the program answered.
"""

import functools
import os
import shutil
import subprocess
import tempfile
from typing import Any

import pytest

NAMES = {
    "chromium": ("chromium", "chromium-browser", "google-chrome", "chrome"),
    "firefox": ("firefox", "firefox-esr"),
    "wine64": ("wine64", "/usr/lib/wine/wine64"),  # where Debian has it
}
"""Names and places of a program, if it has several."""
SANDBOX = ("--no-sandbox",) if os.geteuid() == 0 else ()
"""Options with which Chromium starts for this user."""
TASKS = {
    "gcc": (("-x", "c", "-", "-o", "program"), "#include <math.h>\nint main(void) { return 0; }\n"),
    "g++": (("-x", "c++", "-", "-o", "program"), "#include <vector>\nint main() { return 0; }\n"),
    "arm-none-eabi-gcc": (("-x", "c", "-c", "-", "-o", "object"), "int main(void) { return 0; }\n"),
    "rustc": (("--crate-type=cdylib", "-", "-o", "library"), "pub fn nothing() {}\n"),
    "node": (("-e", "0"), ""),
    "valgrind": (("--quiet", "true"), ""),
    "chromium": (
        ("--headless", "--disable-gpu", *SANDBOX, "--user-data-dir=profile", "--dump-dom", "about:blank"), ""
    ),
}  # fmt: skip
"""Arguments and standard input of a small task, by program or by the end of its name; otherwise `--version`."""

EMULATORS = {
    "aarch64": ("aarch64-linux-gnu-gcc", "qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"),
    "riscv64": ("riscv64-linux-gnu-gcc", "qemu-riscv64", "-L", "/usr/riscv64-linux-gnu"),
    "windows": ("x86_64-w64-mingw32-gcc", "wine64"),
}
"""The compiler for a processor or system, and the command that runs its programs here."""


@functools.cache
def try_program(name: str) -> tuple[str, str]:
    """The path of a program and why it cannot be used ("" if it works), tried once in a session."""
    path = next(filter(None, map(shutil.which, NAMES.get(name, (name,)))), None)
    if path is None:
        return "", f"{name} is not installed"
    arguments, text = TASKS.get(name) or TASKS.get(name.rpartition("-")[2]) or (("--version",), "")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        try:
            done = subprocess.run(
                [path, *arguments], input=text, cwd=folder, capture_output=True, text=True, errors="replace", timeout=60
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            return path, f"{name} does not work: {error}"
    complaint = (done.stderr.strip() or f"exit code {done.returncode}").splitlines()[0]
    return path, f"{name} does not work: {complaint}" if done.returncode else ""


def find_program(name: str) -> str:
    """The path of a program that works; the test is skipped without one."""
    path, reason = try_program(name)
    if reason:
        pytest.skip(reason)
    return path


def run_program(name: str, *arguments: object, **options: Any) -> str:
    """What a program prints that must succeed; the test is skipped where it does not work, or is not there."""
    path = name if os.path.dirname(name) else find_program(name)
    process = subprocess.run([path, *map(str, arguments)], capture_output=True, text=True, check=False, **options)
    assert process.returncode == 0, f"{name} ended with {process.returncode}:\n{process.stdout}{process.stderr}"
    return process.stdout
