"""The C core, built once, in double and in float. Without a C compiler these tests are skipped."""

import pytest

from onboard.c.compile import BuildError, Variant, compiler
from onboard.c.library import Core, load
from tests.onboard.c.parity import SANITIZED

OPTIONS = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all") if SANITIZED else ("-O2",)


@pytest.fixture(scope="session", autouse=True)
def _needs_a_compiler() -> None:
    try:
        compiler()
    except BuildError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def variant(_needs_a_compiler: None) -> Variant:
    return Variant("double", OPTIONS)


@pytest.fixture(scope="session")
def core(variant: Variant) -> Core:
    return load(variant)


@pytest.fixture(scope="session")
def core32(_needs_a_compiler: None) -> Core:
    return load(Variant("float", OPTIONS))
