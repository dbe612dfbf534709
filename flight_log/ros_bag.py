"""Writes a flight as a ROS 2 bag in MCAP: `ros2 bag`, RViz, PlotJuggler and Foxglove read it without a plug-in."""

from pathlib import Path

from rosbags.rosbag2 import StoragePlugin, Writer

from flight_log.log_file import FlightError
from flight_log.reader import Flight
from flight_log.ros_messages import TYPES, ros_messages, typestore

BAG_VERSION = 9


def write_ros_bag(flight: Flight, folder: Path) -> None:
    """Write the bag, a folder with an MCAP file and metadata.yaml, in order of time. Contents: `ros_messages`.

    Raises
    ------
    FlightError
        If the folder exists already, or the flight has nothing to write.
    OSError
        If it cannot be written.
    """
    if folder.exists():
        raise FlightError(f"{folder}: exists already")
    messages = sorted(ros_messages(flight), key=lambda message: message.time_ns)
    if not messages:
        raise FlightError(f"{flight.path}: holds neither onboard/tick nor sim_vehicle/truth: nothing to write")
    with Writer(folder, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP) as bag:
        topics = sorted({message.topic for message in messages})
        connections = {topic: bag.add_connection(topic, TYPES[topic], typestore=typestore()) for topic in topics}
        for message in messages:
            bag.write(connections[message.topic], message.time_ns, message.cdr)
