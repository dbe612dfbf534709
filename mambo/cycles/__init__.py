"""Estimates the cycles of a call on the drone's ARM926, block by block, from the instructions that qemu executes."""
