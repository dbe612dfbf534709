"""Versions to offer to a guard, and a rig that it flies on."""

import dataclasses

import numpy as np

from onboard.control.features import random_channel
from protocol.feature_set import FeatureSet
from tests.onboard.control.fixture import DT, Rig, shipped_controller

INPUTS = ("position_n", "position_e", "position_d", "velocity_n", "velocity_e", "velocity_d")
SLOW = 0.2


def version(number, theta=0.0, gain=SLOW, attitude=False):
    """Smooth features with this last layer, for the position channel or for both."""
    start = random_channel(INPUTS, np.zeros(6), np.ones(6), (8, 5), np.random.default_rng(number))
    last = np.full((6, 3), theta) * np.array([1.0, -1.0, 0.3])
    source = dataclasses.replace(start, weights=tuple(gain * W for W in start.weights), last_layer=last)
    return FeatureSet(number, 0, 100, source, source if attitude else None)


def rig(**guard):
    return Rig(shipped_controller("dmrac", {"guard": guard}))


def flown(one, seconds=0.5):
    one.fly(seconds)
    return one


def fail(guard, channel=0):
    """What a law that has been worse for too long looks like."""
    guard._watches[channel]._worse_s = 1.0
    guard.judge(DT, True)
