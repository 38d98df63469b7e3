"""Clients of a Dask scheduler, whose workers can replace the local processes."""

from __future__ import annotations

import importlib
import re
from typing import Any

from adaptrack.base.errors import InvalidInput, MissingExtra

DASK_TIMEOUT = 5.0
"""s, how long a scheduler may take to say who it is, then to take a client, and then to have its first worker."""

_DASK_ADDRESS = re.compile(r"(?:[a-z]+://)?(?:[^\s:/\[\]]+|\[[0-9A-Fa-f:.]+\]):(?P<port>[0-9]{1,5})/?")
"""tcp://host:port or host:port"""


def dask_client(address: str) -> Any:
    """A client of a Dask scheduler that has workers."""
    try:
        distributed = importlib.import_module("distributed")
    except ImportError:
        raise MissingExtra("Dask is not installed; it comes with: python -m pip install 'adaptrack[cluster]'") from None
    form = _DASK_ADDRESS.fullmatch(address)
    if form is None or not 0 < int(form["port"]) < 65536:
        raise InvalidInput(f"dask = {address!r}: is no address; one looks like tcp://127.0.0.1:8786.")
    try:
        # This comes first: a client waits without end for a server that is silent, and again when it is closed.
        kind = distributed.utils.LoopRunner().run_sync(_kind_of, distributed, address, callback_timeout=DASK_TIMEOUT)
        if kind != "Scheduler":
            raise OSError(f"a {kind} does")
        client = distributed.Client(address, timeout=DASK_TIMEOUT, set_as_default=False)
    except Exception as error:  # of what is not Dask's it makes almost any of them
        raise InvalidInput(
            f"dask = {address!r}: no scheduler answers there ({_reason(error)}); an address looks like "
            "tcp://127.0.0.1:8786."
        ) from None
    try:
        client.wait_for_workers(1, timeout=DASK_TIMEOUT)
    except TimeoutError:
        client.close()
        raise InvalidInput(
            f"dask = {address!r}: the scheduler has no workers; start one or more: dask worker {address}"
        ) from None
    except BaseException:
        client.close()
        raise
    return client


async def _kind_of(distributed: Any, address: str) -> str:
    """Who answers at an address, in Dask's word; most of the time is for the connection, whose errors say more."""
    options = distributed.Security().get_connection_args("client")
    server = await distributed.core.connect(address, timeout=0.8 * DASK_TIMEOUT, **options)
    return str((await distributed.core.send_recv(server, op="identity", close=True))["type"])


def _reason(error: Exception) -> str:
    """Why there is no scheduler."""
    if isinstance(error, TimeoutError):
        return f"silent for {DASK_TIMEOUT:g} s"
    return (
        str(error)
        if isinstance(error, ImportError | OSError | TypeError | ValueError)
        else "what it says is not Dask's"
    )
