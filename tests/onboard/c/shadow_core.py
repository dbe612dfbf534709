"""numpy's whole core with the C core beside it: both get the same datagrams, and all that they do is compared."""

from typing import Any

import numpy as np

from onboard.c.compile import Variant
from onboard.c.compiled_core import CompiledCore
from onboard.config import OnboardConfig
from onboard.core import OnboardCore, OnboardOutput
from onboard.record.tick import OFFSET, TICK
from protocol.endpoint import Endpoint
from protocol.keys import LinkKeys
from protocol.messages import SampleBatch

NUMBERS_MAX = 1e-7
"""Largest difference of a field of the tick record, relative to the field's largest number or 1. Over a flight, sums of
differences grow: a hundred times what was measured is allowed."""
EXACT = (
    "mode",
    "adapting",
    "saturated",
    "feature_version",
    "feature_age",
    "pose_age",
    "offboard_age",
    "battery",
    "law",
)
MOTORS = slice(OFFSET["motor_1"], OFFSET["motor_4"] + 1)
UNKEYED = LinkKeys(None, None, None)


class ShadowCore(OnboardCore):
    """Raises AssertionError at the first difference."""

    def __init__(self, config: OnboardConfig, variant: Variant, keys: LinkKeys = UNKEYED) -> None:
        super().__init__(config, 1, *keys)
        self.ours = CompiledCore(config, 1, *keys, variant=variant)
        self._exact = [OFFSET[name] for name in EXACT]
        self._largest = np.ones(len(TICK.fields))
        self.difference = np.zeros(len(TICK.fields))
        """Largest of each field so far."""
        self.motor_difference = 0.0
        """Largest of all motor commands so far, as a share of the maximum thrust."""
        self._ends = [Endpoint("offboard", 9, keys.offboard) for _ in range(2)]

    def tick(self, *inputs: Any, **named: Any) -> OnboardOutput:
        expected = super().tick(*inputs, **named)
        found = self.ours.tick(*inputs, **named)
        assert found.events == expected.events
        for name in ("to_vehicle", "to_ground"):
            ours, theirs = getattr(found, name), getattr(expected, name)
            assert [len(one) for one in ours] == [len(one) for one in theirs], name
        assert (found.clock_offset is None) == (expected.clock_offset is None)
        self._compare_ticks(found.tick, expected.tick)
        self._compare_talk(found.to_offboard, expected.to_offboard)
        now_ns = inputs[0]
        assert self.ours.airborne == self.airborne
        assert self.ours.status(now_ns).keys() == self.status(now_ns).keys()
        assert self.ours.status(now_ns)["not_ready"] == self.status(now_ns)["not_ready"]
        return expected

    def _compare_ticks(self, found: Any, expected: Any) -> None:
        for index in self._exact:
            assert found[index] == expected[index], TICK.names[index]
        np.maximum(self._largest, np.abs(expected), out=self._largest)
        apart = np.abs(found - expected)
        np.maximum(self.difference, apart, out=self.difference)
        worst = int((apart / self._largest).argmax())
        assert apart[worst] <= NUMBERS_MAX * self._largest[worst], (TICK.names[worst], found[worst], expected[worst])
        self.motor_difference = max(self.motor_difference, float(apart[MOTORS].max()))

    def _compare_talk(self, found: list[bytes], expected: list[bytes]) -> None:
        """Samples but for rounding, everything else bit for bit."""
        assert [len(one) for one in found] == [len(one) for one in expected]
        for ours, theirs in zip(found, expected, strict=True):
            if ours == theirs:
                continue
            one, other = (end.decode(data, 0) for end, data in zip(self._ends, (ours, theirs), strict=True))
            assert isinstance(one, SampleBatch)
            assert isinstance(other, SampleBatch)
            for name in ("first_index", "time_ns", "period_ns", "feature_version"):
                assert getattr(one, name) == getattr(other, name)
            for name in ("signals", "delivered", "adaptive"):
                np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-6, atol=1e-6)

    def compare_summaries(self) -> None:
        """At the end of a flight."""
        found, expected = self.ours.summary(), self.summary()
        assert found.keys() == expected.keys()
        for name in ("mode", "ticks", "missed", "features", "rejected", "vehicle_rejected", "samples", "estimator"):
            assert found[name] == expected[name], name
        for name in ("nis", "calibration"):
            assert found[name].keys() == expected[name].keys()
            for key, value in expected[name].items():
                np.testing.assert_allclose(found[name][key], value, rtol=1e-6, atol=1e-9)
