"""The sockets of one vehicle, and the relay of motion-capture poses."""
