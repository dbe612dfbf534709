"""The loop of the offboard process: one service per vehicle, all in the main thread.

Training runs in the background thread (offboard.background), so that the relay of poses does not wait for it.
"""

import select
import time
from collections.abc import Sequence

from offboard.links.vehicle_service import STEP_PERIOD_NS, VehicleService
from runtime.signals import StopRequest


def serve(services: Sequence[VehicleService], stop: StopRequest) -> int:
    """Serve all vehicles until asked to stop.

    Returns the exit status: 0, or 1 if a service was given up or did not end in order. The others continue when one
    is given up.
    """
    served = list(services)
    while served and stop.count == 0:
        sockets = [socket for service in served for socket in service.sockets]
        readable, _, _ = select.select(sockets, (), (), STEP_PERIOD_NS * 1e-9)
        for service in served:
            if service.due(time.monotonic_ns()) or any(socket in readable for socket in service.sockets):
                service.step()
        for service in [one for one in served if one.given_up]:
            service.end()
            served.remove(service)
    ended = [service.end() for service in served]
    return int(len(ended) < len(services) or not all(ended))
