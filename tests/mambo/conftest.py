"""The drone's library, built once for its processor and once for this machine; skipped without the compilers."""

import shutil

import pytest

from mambo.build import Built, build
from onboard.c.compile import BuildError


@pytest.fixture(scope="session")
def native() -> Built:
    try:
        return build("native")
    except BuildError as error:
        pytest.skip(str(error).splitlines()[0])


@pytest.fixture(scope="session")
def arm() -> Built:
    try:
        return build("arm")
    except BuildError as error:
        pytest.skip(str(error).splitlines()[0])


@pytest.fixture(scope="session")
def qemu(arm: Built) -> Built:
    if shutil.which("qemu-arm") is None:
        pytest.skip("no qemu-arm: install it (Debian and Ubuntu: apt install qemu-user)")
    return arm
