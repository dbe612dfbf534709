"""The file of a memory: what is written is read, and nothing else is accepted."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest

from offboard.memory.memory import CONDITION_COLUMNS, Memory, UnusableMemoryError
from offboard.memory.memory_file import HEADER, dump_memory, is_memory, load_memory, require_fit
from tests.offboard.memory.conditions import FEATURES, condition, random_prior


def memory() -> Memory:
    return Memory(FEATURES, random_prior(), (condition("jet", jet=1.0, rows=50), condition("calm", rows=60, seed=1)), 1)


def changed(**arrays: object) -> bytes:
    """The file with other arrays, and the digest of the original ones."""
    with np.load(io.BytesIO(dump_memory(memory()))) as archive:
        content = {name: archive[name] for name in archive.files} | arrays
    out = io.BytesIO()
    np.savez(out, allow_pickle=False, **content)  # type: ignore[arg-type]
    return out.getvalue()


def with_header(**over: object) -> bytes:
    with np.load(io.BytesIO(dump_memory(memory()))) as archive:
        header = json.loads(archive[HEADER].tobytes()) | over
    return changed(**{HEADER: np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)})


def test_what_is_written_is_read() -> None:
    before, after = memory(), load_memory(dump_memory(memory()))
    assert (after.learnt, after.features) == (before.learnt, before.features)
    assert [one.name for one in after.conditions] == ["jet", "calm"]
    for one, other in zip(before.conditions, after.conditions, strict=True):
        assert one.digest == other.digest
        assert all(
            np.array_equal(getattr(one.samples, name), getattr(other.samples, name)) for name in CONDITION_COLUMNS
        )
    np.testing.assert_array_equal(after.prior.variance, before.prior.variance)
    for W, V in zip(after.prior.network.weights, before.prior.network.weights, strict=True):
        np.testing.assert_array_equal(W, V)
    assert dump_memory(after) == dump_memory(before)
    assert is_memory(dump_memory(before))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not a memory, or damaged"),
        (b"rubbish", "not a memory, or damaged"),
        (dump_memory(memory())[:-3000], "not a memory, or damaged"),
        (with_header(format=99), "format: 99: this version reads format 1"),
        (with_header(signals=["a"]), "signals: not the signals of this version"),
        (changed(variance=np.array([1.0, 2.0])), "sha256"),
    ],
)
def test_other_files_are_refused(data: bytes, message: str) -> None:
    with pytest.raises(UnusableMemoryError, match=message):
        load_memory(data)


def test_every_damaged_byte_is_noticed_or_harmless() -> None:
    data = dump_memory(memory())
    before = dump_memory(load_memory(data))
    for at in np.random.default_rng(0).integers(len(data), size=200):
        broken = bytearray(data)
        broken[at] ^= 0x10
        try:
            assert dump_memory(load_memory(bytes(broken))) == before
        except UnusableMemoryError:
            continue


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda m: replace(m, prior=replace(m.prior, noise=np.array([0.0, 1.0]))), "noise: expected 2 positive"),
        (lambda m: replace(m, prior=replace(m.prior, variance=np.ones(3))), "variance: expected 2 positive"),
        (
            lambda m: replace(
                m, prior=replace(m.prior, network=replace(m.prior.network, last_bias=np.full((2, 1, 3), np.nan)))
            ),
            "last_bias: expected finite float32",
        ),
    ],
)
def test_values_that_cannot_fly_are_refused(make: object, message: str) -> None:
    with pytest.raises(UnusableMemoryError, match=message):
        load_memory(dump_memory(make(memory())))  # type: ignore[operator]


def test_labels_that_are_not_finite_are_refused() -> None:
    bad = memory()
    bad.conditions[1].samples.labels[3, 0, 1] = np.inf
    with pytest.raises(UnusableMemoryError, match="condition_1_labels: a value is not finite"):
        load_memory(dump_memory(bad))


def test_other_networks_are_named() -> None:
    require_fit(FEATURES, FEATURES)
    with pytest.raises(UnusableMemoryError, match=r"features.trained.hidden: \[32, 32\]; allowed is \[16\]"):
        require_fit(FEATURES, FEATURES.model_copy(update={"hidden": (16,)}))
