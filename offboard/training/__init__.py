"""Feature networks, their training, and the gate that decides what is sent."""
