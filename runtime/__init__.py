"""The thin shell around a core: sockets, signals, status lines and what a process asks of the kernel.

The only package of ours, besides the flight record, that touches the world; every `process.py` is built from it.
"""
