"""Lets `jaxact.train(...)` work although Python binds that name to its module on import."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any


class _CallableModule(ModuleType):
    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return getattr(self, self.__name__.rpartition(".")[2])(*args, **kwargs)


def make_callable(name: str) -> None:
    """Makes calling a module call the function in it that bears its name."""
    sys.modules[name].__class__ = _CallableModule
