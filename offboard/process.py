"""The offboard process: for each vehicle a service, and one worker that trains for all of them.

The relay of poses must not wait for training: sockets and cores run in the main thread, a training job in a worker
with a low claim on the processor.
"""

import select
import time
from collections.abc import Sequence

from offboard.links.vehicle_service import STEP_PERIOD_NS, VehicleService
from runtime.signals import StopRequest


def serve(services: Sequence[VehicleService], stop: StopRequest) -> int:
    """Serve all vehicles until asked to end; returns the exit status: 0, or 1 if one was given up or ended badly.

    A vehicle that is given up does not cost the others their teacher.
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
