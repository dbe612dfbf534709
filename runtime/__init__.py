"""What a process needs around its core: sockets, serial port, signals, pace, kernel settings, files and status lines.

Every `process.py` is built from this package. Besides the flight log it is the only package that does I/O.
"""
