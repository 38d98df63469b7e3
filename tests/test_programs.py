"""Programs that tests need are tried, not only looked for."""

import pytest

import programs


@pytest.fixture
def install(tmp_path, monkeypatch):
    """A function that puts a shell script of some name on the PATH."""
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    programs.try_program.cache_clear()

    def write(name, script, mode=0o755):
        (tmp_path / name).write_text(script)
        (tmp_path / name).chmod(mode)

    yield write
    programs.try_program.cache_clear()


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        ("#!/bin/sh\necho 'rustup could not choose a version' >&2; exit 1\n", "rustup could not choose a version"),
        ("#!/bin/sh\nexit 3\n", "exit code 3"),
        ("#!/no/such/interpreter\n", "No such file"),
    ],
)
@pytest.mark.parametrize("name", ["gcc", "rustc", "chromium", "qemu-aarch64"])
def test_a_program_that_fails_is_missing_and_the_reason_is_shown(name, script, reason, install):
    install(name, script)
    with pytest.raises(pytest.skip.Exception, match=f"{name} does not work: .*{reason}"):
        programs.find_program(name)


def test_a_program_that_works_is_tried_once(install, tmp_path):
    install("qemu-aarch64", f"#!/bin/sh\necho tried >> {tmp_path}/trials\n")
    for _ in range(3):
        assert programs.find_program("qemu-aarch64") == str(tmp_path / "qemu-aarch64")
    assert (tmp_path / "trials").read_text() == "tried\n"


def test_a_program_that_nobody_installed_is_missing():
    with pytest.raises(pytest.skip.Exception, match="no-such-program is not installed"):
        programs.find_program("no-such-program")
