"""All tests run under JAX's strict promotion of dtypes, and compile quickly.

They compile far more than they compute, so XLA is told not to optimise, and programs are kept in a
compilation cache for as long as the tests run: for both workers and the processes that they start.
"""

import atexit
import os
import shutil
import tempfile

import pytest

# JAX reads these when it is imported, or first computes something; workers and processes that
# tests start inherit them.
_FAST = (
    "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0 "
    # Two workers keep two cores busy: more threads only cost time.
    "--xla_cpu_parallel_codegen_split_count=1"
)
os.environ.setdefault("XLA_FLAGS", _FAST)
if "PYTEST_XDIST_WORKER" not in os.environ:
    _DIRECTORY = tempfile.mkdtemp(prefix="jaxact-tests-")
    atexit.register(shutil.rmtree, _DIRECTORY, ignore_errors=True)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _DIRECTORY
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.1"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "0"

import jax  # noqa: E402

jax.config.update("jax_numpy_dtype_promotion", "strict")

# They are the longest, and so must not be the last to begin.
_LONG = ("test_notebook.py", "test_readme.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.name not in _LONG)
