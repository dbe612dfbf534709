"""Replays of a recorded flight: with the deliveries of its link, or through a new core bit for bit."""
