"""The short way of the stop key: a request that waits for no page that is being drawn."""

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from softcal.app.line.line import order_stop
from softcal.app.ui.server_cache import registry
from softcal.core.errors import SoftcalError

PATH = "/line-stop"

HEADER = "x-softcal-key"
"""No page of another server can send it: its browser would have to ask this one first."""

LONGEST_NAME = 200


async def stop(request: Request) -> Response:
    """Order a stop of the station that the request names; the page says what came of it."""
    if HEADER not in request.headers:
        return Response(status_code=403)
    station_name = b""
    async for part in request.stream():
        station_name += part
        if len(station_name) > LONGEST_NAME:
            return Response(status_code=413)
    try:
        is_running = await run_in_threadpool(order_stop, registry(), station_name.decode(errors="replace"))
    except SoftcalError:
        return Response(status_code=503)  # The page's own way tries again, and says what is wrong.
    return Response(status_code=204 if is_running else 409)
