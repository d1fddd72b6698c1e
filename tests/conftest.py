"""All tests run under JAX's strict promotion of dtypes, and compile quickly.

They compile far more than they compute, so XLA is told not to optimise.
"""

import os

import jax
import pytest

# Read when JAX first computes something.
_FAST = "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0"
os.environ.setdefault("XLA_FLAGS", _FAST)

jax.config.update("jax_numpy_dtype_promotion", "strict")

# They take minutes, and so must not be the last to begin.
_LONG = ("test_notebook.py", "test_readme.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.name not in _LONG)
