"""The kernels that the page calls, as a module of WebAssembly."""

from __future__ import annotations

from adaptrack.base.errors import InvalidInput
from adaptrack.core import library


def page_kernels() -> bytes:
    """The module.

    Raises
    ------
    InvalidInput
        When it has not been built.
    """
    try:
        return library.whole(library.manifest()["libraries"]["wasm32"]).read_bytes()
    except library.UNUSABLE as error:
        raise InvalidInput(f"the kernels for WebAssembly are not there ({error}): run {library.BUILD} wasm32.") from None
