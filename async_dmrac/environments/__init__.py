"""Gymnasium environments over the compiled batch of vehicles (docs/python.md). Importing this registers them."""

from async_dmrac.environments.registration import register

register()
