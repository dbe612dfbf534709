"""Flights, campaigns and their results: everything that joins the processes together."""
