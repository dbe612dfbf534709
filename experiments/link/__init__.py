"""Experiments on the link: flights with dropouts, transfers across loss, and the tables of docs/link.md."""
