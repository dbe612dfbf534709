"""The flight log: writes, reads, shows, exports and reports flights."""
