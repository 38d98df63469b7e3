"""The kernels that the page calls, as a module of WebAssembly."""

from __future__ import annotations

from adaptrack.base.errors import InvalidInput
from adaptrack.core import library

PAGE_TARGET = "wasm32-page"
"""The name of what is exported for pages."""


def page_kernels() -> bytes:
    """Return the module, compiled now where it is not there.

    Raises
    ------
    InvalidInput
        When it is not there and cannot be compiled.
    """
    try:
        return library.exported(PAGE_TARGET).read_bytes()
    except library.UNUSABLE as error:
        raise InvalidInput(
            f"the kernels for WebAssembly are not there ({error}): run {library.BUILD} --export {PAGE_TARGET}."
        ) from None
