"""MAVLink 2: frames and signing, and for each link the units and field order of its messages."""
