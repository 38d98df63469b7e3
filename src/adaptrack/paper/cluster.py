"""Client of a Dask scheduler, whose workers replace the local processes."""

from __future__ import annotations

import importlib
import re
from typing import Any

from adaptrack.base.errors import InvalidInput, MissingExtra

DASK_TIMEOUT = 5.0
"""s, for the connection to a scheduler, and then for its first worker"""

_ADDRESS = re.compile(r"(?:[a-z]+://)?(?:[^\s:/\[\]]+|\[[0-9A-Fa-f:.]+\]):(?P<port>[0-9]{1,5})/?")
"""tcp://host:port or host:port"""


def dask_client(address: str) -> Any:
    """A `distributed.Client` of the scheduler at an address, once it has a worker.

    Raises
    ------
    MissingExtra
        When Dask is not installed.
    InvalidInput
        When there is no scheduler at the address, or the scheduler has no worker.
    """
    try:
        distributed = importlib.import_module("distributed")
    except ImportError:
        raise MissingExtra("Dask is not installed; install it: python -m pip install 'adaptrack[cluster]'") from None
    form = _ADDRESS.fullmatch(address)
    if form is None or not 0 < int(form["port"]) < 65536:
        raise InvalidInput(f"cluster = {address!r}: not an address; give one like tcp://127.0.0.1:8786.")
    try:
        _check_scheduler(distributed, address)
        client = distributed.Client(address, timeout=DASK_TIMEOUT, set_as_default=False)
    except Exception as error:  # a server other than Dask's can cause almost any error
        reason = str(error) or f"no answer within {DASK_TIMEOUT:g} s"
        raise InvalidInput(f"cluster = {address!r}: no Dask scheduler answers there ({reason}).") from None
    try:
        client.wait_for_workers(1, timeout=DASK_TIMEOUT)
    except TimeoutError:
        client.close()
        raise InvalidInput(
            f"cluster = {address!r}: the scheduler has no workers; start one: dask worker {address}"
        ) from None
    except BaseException:
        client.close()
        raise
    return client


def _check_scheduler(distributed: Any, address: str) -> None:
    """Ask a server for its type within `DASK_TIMEOUT`: a client would wait for a silent server without end."""

    async def ask() -> str:
        options = distributed.Security().get_connection_args("client")
        server = await distributed.core.connect(address, timeout=0.8 * DASK_TIMEOUT, **options)
        return str((await distributed.core.send_recv(server, op="identity", close=True))["type"])

    server_type = distributed.utils.LoopRunner().run_sync(ask, callback_timeout=DASK_TIMEOUT)
    if server_type != "Scheduler":
        raise OSError(f"the server is a {server_type}")
