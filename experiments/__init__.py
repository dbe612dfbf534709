"""Flights and campaigns: the command line and everything that joins the processes together."""
