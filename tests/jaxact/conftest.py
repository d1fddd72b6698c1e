"""Trainings of the one small experiment share its programs, whatever the test."""

from collections.abc import Iterator
from importlib import import_module

import pytest

from tests.tiny import program_of


@pytest.fixture(scope="session", autouse=True)
def shared_programs() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_module("jaxact.train"), "Program", program_of)
        yield
