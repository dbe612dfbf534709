"""Sensor models: rate, delay, noise, bias, quantisation and faults."""
