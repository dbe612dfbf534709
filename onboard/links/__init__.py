"""The wires of the vehicle: MAVLink to vehicle and ground station, msgpack to offboard."""
