"""What crosses the link between onboard and offboard: messages, bytes, repair and statistics. No I/O."""
